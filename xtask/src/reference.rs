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
use syn::{
    Attribute, Expr, Fields, GenericArgument, Item, ItemStruct, Lit, Meta, PathArguments, Type,
};

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

/// A page while its questions are answered.
struct Page<'a> {
    types: &'a BTreeMap<String, Vec<Declared>>,
    /// As on the wire: variants have numbers, and numbers their width.
    is_wire: bool,
    /// Types that were referred to, and the files that do it.
    wanted: Vec<(String, PathBuf)>,
}

impl Reference {
    /// Reads the sources of protocol and host.
    pub(crate) fn read(root: &Path) -> Result<Self> {
        let mut types: BTreeMap<String, Vec<Declared>> = BTreeMap::new();
        let mut folders = vec![root.join("protocol/src")];
        for entry in fs::read_dir(root.join("host"))? {
            let room = entry?.path();
            folders.push(room.join("src"));
            for entry in fs::read_dir(&room)? {
                folders.push(entry?.path().join("src"));
            }
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
        text: &str,
        root: &Path,
        programs: Option<&Path>,
    ) -> Result<String> {
        let mut page = Page {
            types: &self.types,
            is_wire: text.contains("{{message "),
            wanted: Vec::new(),
        };
        let mut out = String::new();
        for line in text.lines() {
            let asked = line.strip_prefix("{{").and_then(|it| it.strip_suffix("}}"));
            let words: Vec<&str> = asked.unwrap_or_default().split(' ').collect();
            match words[..] {
                ["object" | "message", name] => {
                    let declared = page.find(name, Path::new(""))?;
                    let declared =
                        declared.with_context(|| format!("the sources have no type {name}"))?;
                    out += &page.table(declared)?;
                    page.wanted.retain(|it| it.0 != name);
                }
                ["objects", folder] => out += &page.objects(&root.join(folder))?,
                ["commands", file] => out += &page.commands(&root.join(file))?,
                ["definitions"] => out += &page.definitions()?,
                ["table", file, name] => out += &constant(&root.join(file), name)?,
                ["file", file] => {
                    let text = fs::read_to_string(root.join(file)).context(file.to_owned())?;
                    let ending = file.rsplit('.').next().unwrap_or_default();
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
}

impl<'a> Page<'a> {
    /// The objects that the files of a folder print, under the files' names.
    fn objects(&mut self, folder: &Path) -> Result<String> {
        let mut by_file: BTreeMap<&Path, Vec<(&ItemStruct, &Declared)>> = BTreeMap::new();
        for it in self.types.values().flatten() {
            if let Item::Struct(item) = &it.item
                && serialises(&it.item)
                && it.file.starts_with(folder)
            {
                by_file.entry(&it.file).or_default().push((item, it));
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
            let before = std::mem::take(&mut self.wanted);
            let mut tables = Vec::new();
            for (item, it) in all {
                tables.push((item, self.table(it)?));
            }
            for (item, table) in tables {
                if !self.wanted.iter().any(|it| item.ident == it.0) {
                    out += &format!("{}\n\n{table}\n", doc(&item.attrs));
                }
            }
            let below = std::mem::replace(&mut self.wanted, before);
            for (name, from) in below {
                self.want(name, from);
            }
        }
        Ok(out)
    }

    /// The commands of the protocol, with their replies.
    fn commands(&mut self, file: &Path) -> Result<String> {
        let text = fs::read_to_string(file).with_context(|| file.display().to_string())?;
        let list = text
            .split_once("\ncommands! {")
            .and_then(|it| it.1.split_once("\n}"));
        let list = list.with_context(|| format!("{} has no commands", file.display()))?;
        let mut out = "| number | command | reply | meaning |\n|---|---|---|---|\n".to_owned();
        let lines = list.0.lines().filter_map(|line| line.split_once("=>"));
        for (number, (name, reply)) in lines.enumerate() {
            let reply = reply.split(',').next().unwrap_or_default();
            let reply = self.type_text(&syn::parse_str(reply.trim())?, file);
            let command = self.type_text(&syn::parse_str(name.trim())?, file);
            let meaning = match self.find(name.trim(), file)? {
                Some(it) => doc(attributes(&it.item)),
                None => String::new(),
            };
            let _ = writeln!(out, "| {number} | {command} | {reply} | {meaning} |");
        }
        Ok(out)
    }

    /// Each type that was referred to, and those that it refers to.
    fn definitions(&mut self) -> Result<String> {
        let mut out = String::new();
        let mut at = 0;
        while let Some((name, from)) = self.wanted.get(at).cloned() {
            at += 1;
            if let Some(it) = self.find(&name, &from)? {
                let text = doc(attributes(&it.item));
                let _ = writeln!(out, "\n### {name}\n\n{text}\n");
                out += &self.table(it)?;
            }
        }
        Ok(out)
    }

    fn want(&mut self, name: String, from: PathBuf) {
        if !self.wanted.iter().any(|it| it.0 == name) {
            self.wanted.push((name, from));
        }
    }

    /// The type that a file means by a name: its own, that of its crate, or the only one.
    fn find(&self, name: &str, from: &Path) -> Result<Option<&'a Declared>> {
        let all = self.types.get(name).map_or(&[][..], Vec::as_slice);
        let source = from.ancestors().find(|it| it.ends_with("src"));
        let found = all.iter().find(|it| it.file == from);
        let found = found
            .or_else(|| (all.iter()).find(|it| source.is_some_and(|at| it.file.starts_with(at))));
        match (found, all) {
            (Some(found), _) | (None, [found]) => Ok(Some(found)),
            _ => {
                let mut all = all.iter().filter(|it| serialises(&it.item));
                match (all.next(), all.next()) {
                    (found, None) => Ok(found),
                    _ => bail!("several types are called {name}"),
                }
            }
        }
    }

    /// The fields of a struct, or the variants of an enum, as a table.
    fn table(&mut self, it: &Declared) -> Result<String> {
        let mut out = String::new();
        match &it.item {
            Item::Struct(item) => {
                out += "| field | type | meaning |\n|---|---|---|\n";
                self.rows(it, &item.fields, &mut out)?;
            }
            Item::Enum(item) => {
                let rule = serde(&item.attrs, "rename_all");
                if self.is_wire {
                    out += "| number | word | with | meaning |\n|---|---|---|---|\n";
                } else {
                    out += "| word | with | meaning |\n|---|---|---|\n";
                }
                for (number, variant) in item.variants.iter().enumerate() {
                    let parts = variant.fields.iter().map(|field| {
                        let kind = self.type_text(&field.ty, &it.file);
                        let name = field.ident.as_ref();
                        name.map_or(kind.clone(), |name| format!("`{name}`: {kind}"))
                    });
                    let with = parts.collect::<Vec<_>>().join(", ");
                    if self.is_wire {
                        let _ = write!(out, "| {number} ");
                    }
                    let name = variant.ident.to_string();
                    let name = match rule.as_deref() {
                        _ if self.is_wire => name,
                        Some("snake_case") => snake(&name),
                        Some("lowercase") => name.to_lowercase(),
                        _ => name,
                    };
                    let text = doc(&variant.attrs);
                    let _ = writeln!(out, "| `{name}` | {with} | {text} |");
                }
            }
            _ => {}
        }
        Ok(out)
    }

    fn rows(&mut self, it: &Declared, fields: &Fields, out: &mut String) -> Result<()> {
        for (number, field) in fields.iter().enumerate() {
            let is_set = |name| serde(&field.attrs, name).is_some();
            if !self.is_wire && is_set("skip") {
                continue;
            }
            if !self.is_wire && is_set("flatten") {
                let before = std::mem::take(&mut self.wanted);
                self.type_text(&field.ty, &it.file);
                for (name, from) in std::mem::replace(&mut self.wanted, before) {
                    if let Some(below) = self.find(&name, &from)?
                        && let Item::Struct(item) = &below.item
                    {
                        self.rows(below, &item.fields, out)?;
                    }
                }
                continue;
            }
            let name = field.ident.as_ref();
            let name = name.map_or(number.to_string(), ToString::to_string);
            let name = serde(&field.attrs, "rename").unwrap_or(name);
            let name = name.trim_start_matches("r#");
            // A function of its own writes words.
            let mut kind = if is_set("serialize_with") {
                "text".to_owned()
            } else {
                self.type_text(&field.ty, &it.file)
            };
            if !self.is_wire && is_set("skip_serializing_if") {
                kind += ", may be missing";
            }
            let _ = writeln!(out, "| `{name}` | {kind} | {} |", doc(&field.attrs));
        }
        Ok(())
    }

    /// A type as readers know it; types of ours are links, and wanted.
    fn type_text(&mut self, kind: &Type, from: &Path) -> String {
        let path = match kind {
            Type::Reference(it) => return self.type_text(&it.elem, from),
            Type::Array(syn::TypeArray { elem, .. }) | Type::Slice(syn::TypeSlice { elem, .. }) => {
                return format!("list of {}", self.type_text(elem, from));
            }
            Type::Tuple(it) if it.elems.is_empty() => return "nothing".to_owned(),
            Type::Tuple(it) => {
                let each = it.elems.iter().map(|it| self.type_text(it, from));
                return format!("({})", each.collect::<Vec<_>>().join(", "));
            }
            Type::Path(it) => &it.path,
            _ => return String::new(),
        };
        let Some(last) = path.segments.last() else {
            return String::new();
        };
        let mut inner = Vec::new();
        if let PathArguments::AngleBracketed(all) = &last.arguments {
            inner.extend(all.args.iter().filter_map(|it| match it {
                GenericArgument::Type(it) => Some(self.type_text(it, from)),
                _ => None,
            }));
        }
        let name = last.ident.to_string();
        match (name.as_str(), &inner[..]) {
            ("Option", [it]) if self.is_wire => format!("optional {it}"),
            ("Option", [it]) => format!("{it} or `null`"),
            ("Vec" | "VecDeque" | "BTreeSet", [it, ..]) => format!("list of {it}"),
            ("BTreeMap" | "HashMap", [_, it]) => format!("object of {it}"),
            ("Box" | "Arc" | "Cow", [it]) => it.clone(),
            ("Result", [good, bad]) => format!("{good}, or {bad}"),
            ("String" | "str" | "PathBuf" | "Path", _) => "text".to_owned(),
            ("bool", _) => "`true`, `false`".to_owned(),
            _ if is_number(&name) => (if self.is_wire { &name } else { "number" }).to_owned(),
            _ => {
                let found = self.find(&name, from).ok().flatten();
                match found.map(|it| (&it.item, &it.file)) {
                    // Of a number in a unit the number is written.
                    Some((
                        Item::Struct(ItemStruct {
                            fields: Fields::Unnamed(it),
                            ..
                        }),
                        file,
                    )) if it.unnamed.len() == 1 => {
                        format!("{} ({name})", self.type_text(&it.unnamed[0].ty, file))
                    }
                    Some((item, _)) if serialises(item) => {
                        let link = format!("[{name}](#{})", name.to_lowercase());
                        self.want(name, from.to_owned());
                        link
                    }
                    _ => name,
                }
            }
        }
    }
}

/// Of `usize`, `u32` and their like.
fn is_number(name: &str) -> bool {
    let bits = name.trim_start_matches(['u', 'i', 'f']);
    bits == "size" || bits.parse::<u8>().is_ok()
}

fn attributes(item: &Item) -> &[Attribute] {
    match item {
        Item::Struct(it) => &it.attrs,
        Item::Enum(it) => &it.attrs,
        _ => &[],
    }
}

fn serialises(item: &Item) -> bool {
    word(attributes(item), "derive", "Serialize").is_some()
}

fn serde(attributes: &[Attribute], name: &str) -> Option<String> {
    word(attributes, "serde", name)
}

/// The value of a word in an attribute's list; empty where it is a word alone.
fn word(attributes: &[Attribute], list: &str, name: &str) -> Option<String> {
    let mut found = None;
    for attribute in attributes.iter().filter(|it| it.path().is_ident(list)) {
        // What this cannot read is of no interest to it.
        let _ = attribute.parse_nested_meta(|it| {
            let value = match it.value().map(|value| value.parse()) {
                Ok(Ok(Lit::Str(text))) => text.value(),
                _ => String::new(),
            };
            let last = it.path.segments.last();
            if last.is_some_and(|it| it.ident == name) {
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
