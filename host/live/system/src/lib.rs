//! Files that replace their target only when they are whole, and inputs that end.
//!
//! The bytes go into a temporary file beside the target. That file is synced to the
//! disk, takes the target's name in one step, and the folder is synced: a reader, a
//! kill or a power cut finds the old file or the new one, never a part. If anything
//! fails before, the target stays as it is and the temporary file is removed.
//!
//! Permissions: the new file has those of the file that it replaces; where there was
//! none, those that the process's umask leaves of any new file. It belongs to the user
//! who runs the program, and other hard links to the old file keep the old content.
//!
//! Symbolic links: [`replace`] is for a file that its user named, so it goes through a
//! link to the file behind it, and the link stays; a link that leads nowhere is an
//! error. [`put_in_place`] is for files whose names may come from elsewhere: it never
//! goes through a link. There a link counts as a file that is in the way, and with
//! `overwrite` it is the link that is replaced.
//!
//! Inputs: [`open`] takes files only. A pipe may wait for ever and a device may never
//! end. [`read_text`] also bounds the length, for files that are read as a whole. What is read
//! can be watched and ended ([`watch`]).
//!
//! Programs: [`program`] finds one as a shell would, [`shell_word`] writes a path for one.

mod input;

use std::fs::{self, File, Permissions};
use std::io::{self, ErrorKind, Read as _, Write as _};
use std::os::unix::fs::PermissionsExt as _;
use std::path::{Path, PathBuf};

use tempfile::NamedTempFile;

pub use input::{Input, Reading, Sparse, Watching, is_stopped, look, watch};

/// Replaces the file at `path` by `bytes`, or makes it.
///
/// # Errors
///
/// The new file cannot be made, written or renamed, or `path` is a link that leads
/// nowhere.
pub fn replace(path: &Path, bytes: &[u8]) -> io::Result<()> {
    let behind = if path.is_symlink() {
        Some(path.canonicalize()?)
    } else {
        None
    };
    let path = behind.as_deref().unwrap_or(path);
    let mut file = temporary(folder_of(path), permissions_of(path)?)?;
    file.write_all(bytes)?;
    put_in_place(file, path, true)
}

/// A temporary file in `folder` for [`put_in_place`]; dropped before that, it is
/// removed.
///
/// # Errors
///
/// It cannot be made.
pub fn new_file_in(folder: &Path) -> io::Result<NamedTempFile> {
    temporary(folder, None)
}

/// The file of a program: at its path, or by its name on the search path.
#[must_use]
pub fn program(name: &str) -> Option<PathBuf> {
    if name.contains('/') {
        return Some(PathBuf::from(name)).filter(|path| path.is_file());
    }
    let file = format!("{name}{}", std::env::consts::EXE_SUFFIX);
    let path = std::env::var_os("PATH")?;
    std::env::split_paths(&path)
        .map(|folder| folder.join(&file))
        .find(|program| program.is_file())
}

/// A path as a word of a shell's line.
#[must_use]
pub fn shell_word(path: &Path) -> String {
    let text = path.display().to_string();
    let plain = |c: char| c.is_ascii_alphanumeric() || "/._-+:@%,=".contains(c);
    match !text.is_empty() && text.chars().all(plain) {
        true => text,
        false => format!("'{}'", text.replace('\'', "'\\''")),
    }
}

/// Syncs `file`, gives it the name `path` in the same folder, and syncs the folder.
///
/// # Errors
///
/// [`ErrorKind::AlreadyExists`] if something of that name is there and is not to be
/// overwritten; else the file cannot be synced or renamed.
pub fn put_in_place(file: NamedTempFile, path: &Path, overwrite: bool) -> io::Result<()> {
    if overwrite && let Some(permissions) = permissions_of(path)? {
        file.as_file().set_permissions(permissions)?;
    }
    file.as_file().sync_all()?;
    if overwrite {
        file.persist(path)?;
    } else {
        file.persist_noclobber(path)?;
    }
    sync_folder(folder_of(path))
}

/// Opens a file to read it.
///
/// # Errors
///
/// It is not there or may not be read, or it is a folder, a pipe or a device.
pub fn open(path: &Path) -> io::Result<Input> {
    let kind = fs::metadata(path)?.file_type();
    if kind.is_dir() {
        return Err(ErrorKind::IsADirectory.into());
    }
    if !kind.is_file() {
        let what = "it is a pipe or a device; expected a file";
        return Err(io::Error::new(ErrorKind::InvalidInput, what));
    }
    Input::open(path)
}

/// Reads a text of at most `most` bytes.
///
/// # Errors
///
/// As [`open`]; or it cannot be read, is longer, or is no UTF-8
/// ([`ErrorKind::InvalidData`]).
pub fn read_text(path: &Path, most: u64) -> io::Result<String> {
    let mut text = String::new();
    let read = open(path)?.take(most + 1).read_to_string(&mut text)? as u64;
    if read > most {
        let what = format!("it is longer than {most} bytes, the most that such a file can have");
        return Err(io::Error::new(ErrorKind::InvalidData, what));
    }
    Ok(text)
}

/// The folder that a file is in or will be.
#[must_use]
pub fn folder_of(path: &Path) -> &Path {
    match path.parent() {
        Some(folder) if !folder.as_os_str().is_empty() => folder,
        _ => Path::new("."),
    }
}

/// Permissions of the file at `path`; nothing if there is none, or no file.
fn permissions_of(path: &Path) -> io::Result<Option<Permissions>> {
    match fs::symlink_metadata(path) {
        Ok(found) => Ok(found.is_file().then(|| found.permissions())),
        Err(error) if error.kind() == ErrorKind::NotFound => Ok(None),
        Err(error) => Err(error),
    }
}

/// Made with `permissions` from the start, so that what only its owner may read is
/// never open to others.
fn temporary(folder: &Path, permissions: Option<Permissions>) -> io::Result<NamedTempFile> {
    tempfile::Builder::new()
        .prefix(".smartdepthsync-")
        .suffix(".part")
        // The system takes the umask off; `tempfile` alone would make it 0600.
        .permissions(permissions.unwrap_or_else(|| Permissions::from_mode(0o666)))
        .tempfile_in(folder)
}

/// Makes the new name last. The file is in its place by then, so a file system or a
/// folder that does not allow it is no error.
fn sync_folder(folder: &Path) -> io::Result<()> {
    match File::open(folder).and_then(|folder| folder.sync_all()) {
        Err(error)
            if !matches!(
                error.kind(),
                ErrorKind::PermissionDenied | ErrorKind::InvalidInput | ErrorKind::Unsupported
            ) =>
        {
            Err(error)
        }
        _ => Ok(()),
    }
}

#[cfg(test)]
mod tests {
    use std::os::unix::fs::symlink;

    use super::*;

    fn mode(path: &Path) -> u32 {
        fs::metadata(path).unwrap().permissions().mode() & 0o7777
    }

    fn names(folder: &Path) -> usize {
        fs::read_dir(folder).unwrap().count()
    }

    #[test]
    fn a_file_keeps_its_permissions() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("rig.toml");
        for wanted in [0o644, 0o600, 0o664, 0o400] {
            fs::write(&path, "old").unwrap();
            fs::set_permissions(&path, Permissions::from_mode(wanted)).unwrap();
            replace(&path, b"new").unwrap();
            assert_eq!(mode(&path), wanted);
            let file = new_file_in(folder.path()).unwrap();
            put_in_place(file, &path, true).unwrap();
            assert_eq!(mode(&path), wanted);
            fs::remove_file(&path).unwrap();
        }
    }

    #[test]
    fn a_new_file_follows_the_umask() {
        let folder = tempfile::tempdir().unwrap();
        let usual = folder.path().join("usual");
        fs::write(&usual, "").unwrap();
        let replaced = folder.path().join("replaced");
        replace(&replaced, b"new").unwrap();
        let placed = folder.path().join("placed");
        let file = new_file_in(folder.path()).unwrap();
        put_in_place(file, &placed, false).unwrap();
        assert_eq!(mode(&replaced), mode(&usual));
        assert_eq!(mode(&placed), mode(&usual));
        assert_eq!(fs::read(&replaced).unwrap(), b"new");
    }

    #[test]
    fn what_fails_leaves_the_old_file_and_nothing_else() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("taken");
        fs::write(&path, "precious").unwrap();
        let file = new_file_in(folder.path()).unwrap();
        let error = put_in_place(file, &path, false).unwrap_err();
        assert_eq!(error.kind(), ErrorKind::AlreadyExists);
        assert_eq!(fs::read(&path).unwrap(), b"precious");
        drop(new_file_in(folder.path()).unwrap());
        let below = folder.path().join("folder");
        fs::create_dir(&below).unwrap();
        replace(&below, b"x").unwrap_err();
        replace(&folder.path().join("none/x"), b"x").unwrap_err();
        assert_eq!(names(folder.path()), 2);
    }

    #[test]
    fn replace_goes_through_a_link_to_a_file() {
        let folder = tempfile::tempdir().unwrap();
        let (real, link) = (folder.path().join("real"), folder.path().join("a/link"));
        fs::create_dir(folder.path().join("a")).unwrap();
        fs::write(&real, "old").unwrap();
        fs::set_permissions(&real, Permissions::from_mode(0o600)).unwrap();
        symlink("../real", &link).unwrap();
        replace(&link, b"new").unwrap();
        assert!(link.is_symlink());
        assert_eq!(fs::read(&real).unwrap(), b"new");
        assert_eq!(mode(&real), 0o600);
        fs::remove_file(&real).unwrap();
        let error = replace(&link, b"new").unwrap_err();
        assert_eq!(error.kind(), ErrorKind::NotFound);
        assert!(link.is_symlink() && !real.exists());
    }

    #[test]
    fn a_file_that_is_put_in_place_never_goes_through_a_link() {
        let folder = tempfile::tempdir().unwrap();
        let (real, link) = (folder.path().join("real"), folder.path().join("link"));
        fs::write(&real, "precious").unwrap();
        symlink(&real, &link).unwrap();
        let error = put_in_place(new_file_in(folder.path()).unwrap(), &link, false).unwrap_err();
        assert_eq!(error.kind(), ErrorKind::AlreadyExists);
        put_in_place(new_file_in(folder.path()).unwrap(), &link, true).unwrap();
        assert!(!link.is_symlink());
        assert_eq!(fs::read(&real).unwrap(), b"precious");
    }

    #[test]
    fn a_name_without_a_folder_is_in_this_one() {
        assert_eq!(folder_of(Path::new("rig.toml")), Path::new("."));
        assert_eq!(folder_of(Path::new("a/rig.toml")), Path::new("a"));
    }

    #[test]
    fn a_path_is_one_word_of_a_shell() {
        assert_eq!(shell_word(Path::new("recordings/a-1")), "recordings/a-1");
        assert_eq!(shell_word(Path::new("a b's")), "'a b'\\''s'");
        assert_eq!(shell_word(Path::new("$(x)")), "'$(x)'");
    }
}
