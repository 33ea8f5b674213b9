//! The firmware's ELF: what is loaded, its symbols, and its source lines.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use gimli::{Dwarf, EndianSlice, LittleEndian};
use object::{Object, ObjectSection, ObjectSymbol, SymbolKind};

/// The source lines of a firmware.
pub(crate) type Lines<'a> = addr2line::Context<EndianSlice<'a, LittleEndian>>;

/// A symbol of the firmware.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Symbol {
    /// Address.
    pub address: u32,
    /// Size in bytes; 0 if the ELF does not say.
    pub size: u32,
}

/// A firmware image with its symbols.
pub struct Firmware {
    path: PathBuf,
    bytes: Vec<u8>,
    segments: Vec<(u32, Vec<u8>)>,
    symbols: BTreeMap<String, Symbol>,
    functions: BTreeMap<u32, (u32, String)>,
}

impl core::fmt::Debug for Firmware {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        write!(f, "Firmware({})", self.path.display())
    }
}

impl Firmware {
    /// Reads an ELF; without one there, `hint` says what to do.
    ///
    /// # Errors
    ///
    /// There is no such file, or it is not for a Cortex-M with flash at `0x0800_0000`.
    pub fn load(path: &Path, hint: &str) -> Result<Self, String> {
        let name = path.display();
        if !path.is_file() {
            let colon = if hint.is_empty() { "" } else { ": " };
            return Err(format!("no firmware ELF at {name}{colon}{hint}"));
        }
        let bytes = std::fs::read(path).map_err(|error| format!("cannot read {name}: {error}"))?;
        let bad = |why: String| format!("{name} is not a firmware of this board: {why}");
        let file = object::File::parse(&*bytes).map_err(|e| bad(e.to_string()))?;
        if file.architecture() != object::Architecture::Arm {
            return Err(bad(format!("it is for {:?}", file.architecture())));
        }
        let mut segments = Vec::new();
        if let object::File::Elf32(elf) = &file {
            use object::read::elf::ProgramHeader;
            let endian = elf.endian();
            for header in elf.elf_program_headers() {
                if header.p_type(endian) == object::elf::PT_LOAD && header.p_filesz(endian) > 0 {
                    let data = header
                        .data(endian, &*bytes)
                        .map_err(|()| bad("a segment lies outside of the file".into()))?;
                    segments.push((header.p_paddr(endian), data.to_vec()));
                }
            }
        } else {
            return Err(bad("it is not a 32-bit ELF".into()));
        }
        if !segments.iter().any(|(at, _)| *at == 0x0800_0000) {
            return Err(bad("nothing is loaded at 0x0800_0000".into()));
        }
        let mut symbols = BTreeMap::new();
        let mut functions = BTreeMap::new();
        for s in file.symbols() {
            let Ok(name) = s.name() else { continue };
            if name.is_empty() || name.starts_with('$') {
                continue;
            }
            let thumb = s.kind() == SymbolKind::Text;
            let address = s.address() as u32 & if thumb { !1 } else { u32::MAX };
            let size = s.size() as u32;
            if thumb {
                let pretty = format!("{:#}", rustc_demangle::demangle(name));
                functions.insert(address, (size, pretty));
            }
            symbols.insert(name.to_owned(), Symbol { address, size });
        }
        Ok(Self {
            path: path.to_path_buf(),
            segments,
            symbols,
            functions,
            bytes,
        })
    }

    /// Where the ELF was read from.
    #[must_use]
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// The file.
    pub(crate) fn bytes(&self) -> &[u8] {
        &self.bytes
    }

    /// Contents of the flash: load address and bytes.
    pub(crate) fn segments(&self) -> &[(u32, Vec<u8>)] {
        &self.segments
    }

    /// Bytes of flash that the firmware takes.
    pub(crate) fn flash_size(&self) -> usize {
        self.segments
            .iter()
            .filter(|(at, _)| at >> 24 == 0x08)
            .map(|(at, data)| (*at - 0x0800_0000) as usize + data.len())
            .max()
            .unwrap_or(0)
    }

    /// A symbol by its exact (mangled) name.
    #[must_use]
    pub fn symbol(&self, name: &str) -> Option<Symbol> {
        self.symbols.get(name).copied()
    }

    /// The first symbol whose demangled path ends with `path`.
    #[must_use]
    pub(crate) fn find_symbol(&self, path: &str) -> Option<Symbol> {
        self.symbols
            .iter()
            .find(|(name, _)| {
                let pretty = format!("{:#}", rustc_demangle::demangle(name));
                pretty == path || pretty.ends_with(&format!("::{path}"))
            })
            .map(|(_, s)| *s)
    }

    /// The function that holds an address: name and offset.
    #[must_use]
    pub(crate) fn function_at(&self, address: u32) -> Option<(&str, u32)> {
        let (start, (size, name)) = self.functions.range(..=address).next_back()?;
        let offset = address - start;
        (*size == 0 || offset < *size).then_some((name.as_str(), offset))
    }

    /// The source lines, if the ELF has them.
    pub(crate) fn lines(&self) -> Option<Lines<'_>> {
        let file = object::File::parse(&*self.bytes).ok()?;
        let section = |id: gimli::SectionId| {
            let section = file.section_by_name(id.name());
            let data = section
                .and_then(|section| section.data().ok())
                .unwrap_or_default();
            Ok::<_, gimli::Error>(EndianSlice::new(data, LittleEndian))
        };
        Lines::from_dwarf(Dwarf::load(section).ok()?).ok()
    }

    /// An address for people: inlined functions outwards, with their source lines.
    #[must_use]
    pub(crate) fn describe(&self, lines: Option<&Lines<'_>>, address: u32) -> Vec<String> {
        let mut out = Vec::new();
        if let Some(lines) = lines
            && let Ok(mut frames) = lines.find_frames(address.into()).skip_all_loads()
        {
            while let Ok(Some(frame)) = frames.next() {
                let name = frame
                    .function
                    .as_ref()
                    .and_then(|f| f.demangle().ok().map(std::borrow::Cow::into_owned))
                    .unwrap_or_else(|| "?".into());
                match frame.location {
                    Some(l) => out.push(format!(
                        "{name} at {}:{}",
                        l.file.unwrap_or("?"),
                        l.line.unwrap_or(0)
                    )),
                    None => out.push(name),
                }
            }
        }
        if out.is_empty() {
            out.push(match self.function_at(address) {
                Some((name, offset)) => format!("{name} + {offset:#x}"),
                None => format!("{address:#010x}"),
            });
        }
        out
    }
}
