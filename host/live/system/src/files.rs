//! Files that appear whole or not at all.
//!
//! The bytes go into a temporary file beside the target. That file is synced to the disk, takes
//! the target's name in one step, and the folder is synced: after a kill or a power cut there is
//! the old file or the new one, never a part. If a step fails, the target stays as it was and the
//! temporary file is removed; that of a program that was killed is removed by the next [`replace`] in
//! its folder.
//!
//! Permissions: the new file has those of the file that it replaces, or those that the process's
//! umask leaves for a new one. It belongs to the user who runs the program, and other hard links to
//! the old file keep the old content.
//!
//! Symbolic links: [`replace`] is for a file that its user named, so it follows a link and replaces
//! the file that the link leads to; a dangling link is an error. [`put_in_place`] is for files whose
//! names may come from elsewhere, so it never follows a link: without `overwrite` a link is in the
//! way, with it the link itself is replaced.

use std::fs::{self, File, Permissions};
use std::io::{self, ErrorKind, Write as _};
use std::os::unix::fs::PermissionsExt as _;
use std::path::{Path, PathBuf};
use std::time::Duration;

use tempfile::NamedTempFile;

/// Begin and end of the names of temporary files.
const PREFIX: &str = ".smartdepthsync-";
const SUFFIX: &str = ".part";

/// Time after which a temporary file that nobody holds is left over: a new one is not locked at once.
const LEFT_FOR: Duration = Duration::from_secs(10);

/// Replaces the file at `path` with `bytes`, or creates it.
///
/// # Errors
///
/// The new file cannot be created, written or renamed, or `path` is a dangling link.
pub fn replace(path: &Path, bytes: &[u8]) -> io::Result<()> {
    let target = if path.is_symlink() {
        Some(path.canonicalize()?)
    } else {
        None
    };
    let path = target.as_deref().unwrap_or(path);
    remove_leftovers(folder_of(path), LEFT_FOR);
    let mut file = temporary(folder_of(path), permissions_of(path)?)?;
    file.write_all(bytes)?;
    put_in_place(file, path, true)
}

/// Creates a temporary file in `folder` for [`put_in_place`]. Dropping it removes it.
///
/// # Errors
///
/// The file cannot be created.
pub fn new_file_in(folder: &Path) -> io::Result<NamedTempFile> {
    temporary(folder, None)
}

/// Syncs `file`, renames it to `path` in the same folder, and syncs the folder.
///
/// # Errors
///
/// [`ErrorKind::AlreadyExists`] if `path` exists and `overwrite` is false; else the file cannot be
/// synced or renamed.
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

/// Returns the folder of a file that may not exist yet: the current one for a bare name.
#[must_use]
pub fn folder_of(path: &Path) -> &Path {
    match path.parent() {
        Some(folder) if !folder.as_os_str().is_empty() => folder,
        _ => Path::new("."),
    }
}

/// Returns the permissions of the file at `path`, or `None` if there is none or `path` is no
/// regular file.
fn permissions_of(path: &Path) -> io::Result<Option<Permissions>> {
    match fs::symlink_metadata(path) {
        Ok(found) => Ok(found.is_file().then(|| found.permissions())),
        Err(error) if error.kind() == ErrorKind::NotFound => Ok(None),
        Err(error) => Err(error),
    }
}

/// Creates a temporary file that has `permissions` from the start, so that a private file is never
/// open to others.
fn temporary(folder: &Path, permissions: Option<Permissions>) -> io::Result<NamedTempFile> {
    let file = tempfile::Builder::new()
        .prefix(PREFIX)
        .suffix(SUFFIX)
        // The system applies the umask; the default of `tempfile` is 0600.
        .permissions(permissions.unwrap_or_else(|| Permissions::from_mode(0o666)))
        .tempfile_in(folder)?;
    // Held while the program lives. A file system without locks is used without.
    let _ = file.as_file().try_lock();
    Ok(file)
}

/// Removes temporary files in a folder that no program holds, and that were last written `age` ago. Those
/// that cannot be removed do no harm.
fn remove_leftovers(folder: &Path, age: Duration) {
    let entries = fs::read_dir(folder).into_iter().flatten().flatten();
    let is_temporary = |path: &PathBuf| {
        let name = path.file_name().unwrap_or_default().to_string_lossy();
        name.starts_with(PREFIX) && name.ends_with(SUFFIX)
    };
    for path in entries.map(|entry| entry.path()).filter(is_temporary) {
        let is_left = File::open(&path).is_ok_and(|file| {
            let modified = file.metadata().and_then(|meta| meta.modified());
            let is_old = modified.is_ok_and(|at| at.elapsed().is_ok_and(|since| since >= age));
            is_old && file.try_lock().is_ok()
        });
        if is_left {
            let _ = fs::remove_file(&path);
        }
    }
}

/// Makes a new name durable. A file system or folder that does not allow this is no error: the
/// file is in place already.
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
    fn what_a_killed_program_left_is_removed_and_what_a_running_one_holds_is_not() {
        let folder = tempfile::tempdir().unwrap();
        let held = new_file_in(folder.path()).unwrap();
        // The lock ends with the program; the file stays.
        let (left, path) = new_file_in(folder.path()).unwrap().keep().unwrap();
        drop(left);
        remove_leftovers(folder.path(), LEFT_FOR);
        assert!(path.exists());
        remove_leftovers(folder.path(), Duration::ZERO);
        assert!(!path.exists() && held.path().exists());
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
    fn a_failure_leaves_the_old_file_and_nothing_else() {
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
    fn replace_follows_a_link_to_a_file() {
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
    fn put_in_place_never_follows_a_link() {
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
    fn a_bare_name_is_in_the_current_folder() {
        assert_eq!(folder_of(Path::new("rig.toml")), Path::new("."));
        assert_eq!(folder_of(Path::new("a/rig.toml")), Path::new("a"));
    }
}
