//! Reference in the book that is made from the code: objects and messages from their types,
//! tables from constants, files as they are, and the help of a program.
//!
//! A page asks for it by a line of its own: `{{object NAME}}`, `{{objects FOLDER}}`,
//! `{{message NAME}}`, `{{commands FILE}}`, `{{definitions}}` (what the ones before it refer
//! to), `{{table FILE NAME}}`, `{{file FILE}}`, `{{help PROGRAM}}`.

use std::collections::BTreeMap;
use std::fmt::Write as _;
use std::fs;
use std::path::{Path, PathBuf};

use anyhow::{Context, Result, bail};
use syn::{Attribute, Expr, Fields, GenericArgument, Item, Lit, Meta, PathArguments, Type};

use crate::process;

/// A struct or an enum, and the file in which it is.
struct Declared {
    file: PathBuf,
    item: Item,
}

/// The types of the sources.
pub(crate) struct Reference {
    types: BTreeMap<String, Vec<Declared>>,
}

/// A type that was referred to: its name, the file that does it, and as what to write it.
#[derive(Clone, PartialEq)]
struct Wanted {
    name: String,
    from: PathBuf,
    is_message: bool,
}

impl Reference {
    /// Reads the sources of protocol and host.
    pub(crate) fn read(root: &Path) -> Result<Self> {
        let mut types: BTreeMap<String, Vec<Declared>> = BTreeMap::new();
        let mut folders = vec![root.join("protocol/src")];
        for entry in fs::read_dir(root.join("host"))? {
            folders.push(entry?.path().join("src"));
        }
        for folder in folders.iter().filter(|folder| folder.is_dir()) {
            for file in process::files_below(folder)? {
                if file.extension().is_none_or(|extension| extension != "rs") {
                    continue;
                }
                let text = fs::read_to_string(&file)?;
                let parsed = syn::parse_file(&text)
                    .with_context(|| format!("cannot read {}", file.display()))?;
                for item in parsed.items {
                    let name = match &item {
                        Item::Struct(it) => it.ident.to_string(),
                        Item::Enum(it) => it.ident.to_string(),
                        _ => continue,
                    };
                    let file = file.clone();
                    types.entry(name).or_default().push(Declared { file, item });
                }
            }
        }
        Ok(Self { types })
    }

    /// A page with all that it asks for. The help of programs is left out unless they are built.
    pub(crate) fn expand(
        &self,
        page: &str,
        root: &Path,
        programs: Option<&Path>,
    ) -> Result<String> {
        let mut out = String::new();
        let mut wanted = Vec::new();
        for line in page.lines() {
            let asked = line.strip_prefix("{{").and_then(|it| it.strip_suffix("}}"));
            let words: Vec<&str> = asked.unwrap_or_default().split(' ').collect();
            match words[..] {
                [kind @ ("object" | "message"), name] => {
                    let is_message = kind == "message";
                    let from = PathBuf::new();
                    let name = name.to_owned();
                    let asked = Wanted {
                        name,
                        from,
                        is_message,
                    };
                    let declared = self
                        .find(&asked)?
                        .with_context(|| format!("the sources have no type {}", asked.name))?;
                    out += &self.table(declared, is_message, &mut wanted)?;
                    wanted.retain(|it| it.name != asked.name);
                }
                ["objects", folder] => {
                    out += &self.objects(&root.join(folder), &mut wanted)?;
                }
                ["commands", file] => {
                    out += &self.commands(&root.join(file), &mut wanted)?;
                }
                ["definitions"] => out += &self.definitions(&mut wanted)?,
                ["table", file, name] => out += &constant(&root.join(file), name)?,
                ["file", file] => {
                    let text = fs::read_to_string(root.join(file)).context(file.to_owned())?;
                    let ending = Path::new(file).extension().unwrap_or_default();
                    let ending = ending.to_string_lossy();
                    let _ = writeln!(out, "```{ending}\n{}\n```", text.trim_end());
                }
                ["help", program] => {
                    if let Some(folder) = programs {
                        out += &help(&folder.join(program), &mut vec![program.to_owned()])?;
                    }
                }
                _ if asked.is_some() => bail!("no page can ask for {line}"),
                _ => {
                    out += line;
                    out.push('\n');
                }
            }
        }
        Ok(out)
    }

    /// The objects that the files of a folder print, under the files' names.
    fn objects(&self, folder: &Path, wanted: &mut Vec<Wanted>) -> Result<String> {
        let mut by_file: BTreeMap<&Path, Vec<&Declared>> = BTreeMap::new();
        for it in self.types.values().flatten() {
            let is_printed = matches!(it.item, Item::Struct(_)) && serialises(&it.item);
            if is_printed && it.file.starts_with(folder) {
                by_file.entry(&it.file).or_default().push(it);
            }
        }
        let mut out = String::new();
        for (file, all) in by_file {
            let mut name = file.strip_prefix(folder)?.with_extension("");
            if name == Path::new("lib") {
                // Of a crate with one file the crate's name: its folder's.
                name = folder.iter().rev().nth(1).unwrap_or_default().into();
            }
            let words: Vec<_> = name.iter().map(|part| part.to_string_lossy()).collect();
            let _ = writeln!(out, "\n## {}\n", words.join(" ").replace('_', " "));
            let mut below = Vec::new();
            let mut tables = Vec::new();
            for it in all {
                tables.push((it, self.table(it, false, &mut below)?));
            }
            for (it, table) in tables {
                let Item::Struct(item) = &it.item else {
                    continue;
                };
                if !below.iter().any(|wanted| item.ident == wanted.name) {
                    out += &format!("{}\n\n{table}\n", doc(&item.attrs));
                }
            }
            below.retain(|asked| !wanted.iter().any(|it| it.name == asked.name));
            wanted.append(&mut below);
        }
        Ok(out)
    }

    /// The commands of the protocol, with their replies.
    fn commands(&self, file: &Path, wanted: &mut Vec<Wanted>) -> Result<String> {
        let text = fs::read_to_string(file).with_context(|| file.display().to_string())?;
        let list = text
            .split_once("\ncommands! {")
            .and_then(|it| it.1.split_once("\n}"));
        let list = list
            .with_context(|| format!("{} has no commands", file.display()))?
            .0;
        let mut out = "| number | command | reply | meaning |\n|---|---|---|---|\n".to_owned();
        for (number, line) in list.lines().filter(|it| it.contains("=>")).enumerate() {
            let (name, reply) = line.split_once("=>").unwrap_or_default();
            let reply = reply.split(',').next().unwrap_or_default();
            let kind = syn::parse_str(reply.trim())?;
            let reply = self.type_text(&kind, file, true, wanted);
            let kind = syn::parse_str(name.trim())?;
            let command = self.type_text(&kind, file, true, wanted);
            let meaning = match self.types.get(name.trim()).map(Vec::as_slice) {
                Some(
                    [
                        Declared {
                            item: Item::Struct(it),
                            ..
                        },
                    ],
                ) => doc(&it.attrs),
                _ => String::new(),
            };
            let _ = writeln!(out, "| {number} | {command} | {reply} | {meaning} |");
        }
        Ok(out)
    }

    /// Each type that was referred to, and those that it refers to.
    fn definitions(&self, wanted: &mut Vec<Wanted>) -> Result<String> {
        let mut out = String::new();
        let mut at = 0;
        while let Some(asked) = wanted.get(at).cloned() {
            at += 1;
            let Some(declared) = self.find(&asked)? else {
                continue;
            };
            let _ = writeln!(out, "\n### {}\n", asked.name);
            let (Item::Struct(syn::ItemStruct { attrs, .. })
            | Item::Enum(syn::ItemEnum { attrs, .. })) = &declared.item
            else {
                continue;
            };
            let _ = writeln!(out, "{}\n", doc(attrs));
            out += &self.table(declared, asked.is_message, wanted)?;
        }
        wanted.clear();
        Ok(out)
    }

    /// The type that a file means by a name: its own, that of its crate, or the only one.
    fn find(&self, wanted: &Wanted) -> Result<Option<&Declared>> {
        let Some(all) = self.types.get(&wanted.name) else {
            return Ok(None);
        };
        let in_crate = |declared: &&Declared| {
            let depth = |file: &Path| {
                let parts: Vec<_> = file.components().collect();
                let src = parts.iter().rposition(|part| part.as_os_str() == "src");
                parts[..src.unwrap_or(0)].iter().collect::<PathBuf>()
            };
            depth(&declared.file) == depth(&wanted.from)
        };
        let found = all.iter().find(|it| it.file == wanted.from);
        let found = found.or_else(|| all.iter().find(in_crate));
        match (found, &all[..]) {
            (Some(found), _) | (None, [found]) => Ok(Some(found)),
            _ => {
                let serialised = |it: &&Declared| serialises(&it.item);
                let mut all = all.iter().filter(serialised);
                match (all.next(), all.next()) {
                    (found, None) => Ok(found),
                    _ => bail!("several types are called {}", wanted.name),
                }
            }
        }
    }

    /// The fields of a struct, or the variants of an enum, as a table.
    fn table(&self, it: &Declared, is_message: bool, wanted: &mut Vec<Wanted>) -> Result<String> {
        let mut out = String::new();
        match &it.item {
            Item::Struct(item) => {
                out += "| field | type | meaning |\n|---|---|---|\n";
                self.rows(it, &item.fields, is_message, wanted, &mut out)?;
            }
            Item::Enum(item) => {
                let rule = serde(&item.attrs, "rename_all");
                let head = if is_message { "| number " } else { "" };
                let line = if is_message { "|---" } else { "" };
                let _ = writeln!(out, "{head}| word | with | meaning |\n{line}|---|---|---|");
                for (number, variant) in item.variants.iter().enumerate() {
                    let mut parts = Vec::new();
                    for field in &variant.fields {
                        let kind = self.type_text(&field.ty, &it.file, is_message, wanted);
                        parts.push(match &field.ident {
                            Some(name) => format!("`{name}`: {kind}"),
                            None => kind,
                        });
                    }
                    if is_message {
                        let _ = write!(out, "| {number} ");
                    }
                    let name = variant.ident.to_string();
                    let name = match rule.as_deref() {
                        _ if is_message => name,
                        Some("snake_case") => snake(&name),
                        Some("lowercase") => name.to_lowercase(),
                        Some("kebab-case") => snake(&name).replace('_', "-"),
                        _ => name,
                    };
                    let (with, text) = (parts.join(", "), doc(&variant.attrs));
                    let _ = writeln!(out, "| `{name}` | {with} | {text} |");
                }
            }
            _ => {}
        }
        Ok(out)
    }

    fn rows(
        &self,
        it: &Declared,
        fields: &Fields,
        is_message: bool,
        wanted: &mut Vec<Wanted>,
        out: &mut String,
    ) -> Result<()> {
        for (number, field) in fields.iter().enumerate() {
            let is_set = |name| !is_message && serde(&field.attrs, name).is_some();
            if is_set("skip") {
                continue;
            }
            if is_set("flatten") {
                let mut inner = Vec::new();
                self.type_text(&field.ty, &it.file, is_message, &mut inner);
                for asked in inner {
                    if let Some(below) = self.find(&asked)?
                        && let Item::Struct(item) = &below.item
                    {
                        self.rows(below, &item.fields, is_message, wanted, out)?;
                    }
                }
                continue;
            }
            let name = field
                .ident
                .as_ref()
                .map_or(number.to_string(), ToString::to_string);
            let name = serde(&field.attrs, "rename").unwrap_or(name);
            let name = name.trim_start_matches("r#");
            let mut kind = self.type_text(&field.ty, &it.file, is_message, wanted);
            if is_set("skip_serializing_if") {
                kind += ", may be missing";
            }
            let _ = writeln!(out, "| `{name}` | {kind} | {} |", doc(&field.attrs));
        }
        Ok(())
    }

    /// A type as readers know it; types of ours are links, and wanted.
    fn type_text(
        &self,
        kind: &Type,
        from: &Path,
        is_message: bool,
        wanted: &mut Vec<Wanted>,
    ) -> String {
        let path = match kind {
            Type::Reference(it) => return self.type_text(&it.elem, from, is_message, wanted),
            Type::Array(syn::TypeArray { elem, .. }) | Type::Slice(syn::TypeSlice { elem, .. }) => {
                return format!("list of {}", self.type_text(elem, from, is_message, wanted));
            }
            Type::Tuple(it) => {
                if it.elems.is_empty() {
                    return "nothing".to_owned();
                }
                let each = it.elems.iter();
                let each = each.map(|it| self.type_text(it, from, is_message, wanted));
                return format!("({})", each.collect::<Vec<_>>().join(", "));
            }
            Type::Path(it) => &it.path,
            _ => return String::new(),
        };
        let Some(last) = path.segments.last() else {
            return String::new();
        };
        let mut inner = Vec::new();
        if let PathArguments::AngleBracketed(it) = &last.arguments {
            for argument in &it.args {
                if let GenericArgument::Type(it) = argument {
                    inner.push(self.type_text(it, from, is_message, wanted));
                }
            }
        }
        let name = last.ident.to_string();
        match (name.as_str(), &inner[..]) {
            ("Option", [it]) if is_message => format!("optional {it}"),
            ("Option", [it]) => format!("{it} or `null`"),
            ("Vec" | "VecDeque" | "BTreeSet", [it, ..]) => format!("list of {it}"),
            ("BTreeMap" | "HashMap", [_, it]) => format!("object of {it}"),
            ("Box" | "Arc" | "Cow", [it]) => it.clone(),
            ("Result", [good, bad]) => format!("{good}, or {bad}"),
            ("String" | "str" | "PathBuf" | "Path", _) => "text".to_owned(),
            ("bool", _) => "`true`, `false`".to_owned(),
            (
                "u8" | "u16" | "u32" | "u64" | "usize" | "i8" | "i16" | "i32" | "i64" | "f32"
                | "f64" | "u128" | "i128",
                _,
            ) => (if is_message { name.as_str() } else { "number" }).to_owned(),
            _ => {
                let from = from.to_owned();
                let asked = Wanted {
                    name,
                    from,
                    is_message,
                };
                let found = self.find(&asked).ok().flatten();
                match found.map(|it| (&it.item, &it.file)) {
                    // Of a number in a unit the number is written.
                    Some((Item::Struct(it), file))
                        if matches!(&it.fields, Fields::Unnamed(_)) && it.fields.len() == 1 =>
                    {
                        let number = it.fields.iter().next().map(|it| &it.ty);
                        let number = number.map(|it| self.type_text(it, file, is_message, wanted));
                        format!("{} ({})", number.unwrap_or_default(), asked.name)
                    }
                    Some((item, _)) if serialises(item) => {
                        let link = format!("[{0}](#{1})", asked.name, asked.name.to_lowercase());
                        if !wanted.iter().any(|it| it.name == asked.name) {
                            wanted.push(asked);
                        }
                        link
                    }
                    _ => asked.name,
                }
            }
        }
    }
}

fn serialises(item: &Item) -> bool {
    let (Item::Struct(syn::ItemStruct { attrs, .. }) | Item::Enum(syn::ItemEnum { attrs, .. })) =
        item
    else {
        return false;
    };
    attrs.iter().any(|attribute| {
        let mut found = false;
        let _ = attribute.path().is_ident("derive").then(|| {
            attribute.parse_nested_meta(|it| {
                found |= it
                    .path
                    .segments
                    .last()
                    .is_some_and(|it| it.ident == "Serialize");
                Ok(())
            })
        });
        found
    })
}

/// What serde is told of a field or type; empty where it is a word alone.
fn serde(attributes: &[Attribute], name: &str) -> Option<String> {
    let mut found = None;
    for attribute in attributes.iter().filter(|it| it.path().is_ident("serde")) {
        // What this cannot read is of no interest to it.
        let _ = attribute.parse_nested_meta(|it| {
            let value = match it.value() {
                Ok(value) => match value.parse::<Lit>()? {
                    Lit::Str(text) => text.value(),
                    _ => String::new(),
                },
                Err(_) => String::new(),
            };
            if it.path.is_ident(name) {
                found = Some(value);
            }
            Ok(())
        });
    }
    found
}

/// The comment of a field, variant or type, in one line, without the links of rustdoc.
fn doc(attributes: &[Attribute]) -> String {
    let mut lines = Vec::new();
    for attribute in attributes.iter().filter(|it| it.path().is_ident("doc")) {
        if let Meta::NameValue(it) = &attribute.meta
            && let Expr::Lit(it) = &it.value
            && let Lit::Str(text) = &it.lit
        {
            lines.push(text.value().trim().to_owned());
        }
    }
    let text = lines.join(" ").replace('|', "\\|");
    let text = text.replace("[`", "`").replace("`]", "`");
    text.replace("`crate::", "`")
}

fn snake(name: &str) -> String {
    let mut out = String::new();
    for letter in name.chars() {
        if letter.is_uppercase() && !out.is_empty() {
            out.push('_');
        }
        out.extend(letter.to_lowercase());
    }
    out
}

/// A constant text.
fn constant(file: &Path, name: &str) -> Result<String> {
    let text = fs::read_to_string(file).with_context(|| file.display().to_string())?;
    for item in syn::parse_file(&text)?.items {
        if let Item::Const(it) = item
            && it.ident == name
            && let Expr::Lit(it) = *it.expr
            && let Lit::Str(text) = it.lit
        {
            return Ok(text.value());
        }
    }
    bail!("{} has no text {name}", file.display())
}

/// The help of a program and of all its commands.
fn help(program: &Path, path: &mut Vec<String>) -> Result<String> {
    let mut command = process::command(program);
    let text = process::text(command.args(&path[1..]).arg("--help"))?;
    let mut out = format!("\n## {}\n\n```text\n{}\n```\n", path.join(" "), text.trim());
    let commands = text.split_once("\nCommands:\n").map_or("", |it| it.1);
    for line in commands.lines().take_while(|line| !line.is_empty()) {
        let name = line.strip_prefix("  ").filter(|it| !it.starts_with(' '));
        let name = name.and_then(|it| it.split(' ').next()).unwrap_or("help");
        if name != "help" {
            path.push(name.to_owned());
            out += &help(program, path)?;
            path.pop();
        }
    }
    Ok(out)
}
