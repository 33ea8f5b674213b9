//! Programs and paths as a shell sees them.

use std::path::{Path, PathBuf};

/// Returns the path of a program: `name` itself if it contains a slash, else the first match on
/// `PATH`. Returns `None` if there is no such file.
#[must_use]
pub fn find_program(name: &str) -> Option<PathBuf> {
    if name.contains('/') {
        return Some(PathBuf::from(name)).filter(|path| path.is_file());
    }
    let file = format!("{name}{}", std::env::consts::EXE_SUFFIX);
    let path = std::env::var_os("PATH")?;
    std::env::split_paths(&path)
        .map(|folder| folder.join(&file))
        .find(|program| program.is_file())
}

/// Returns a path as one word of a shell's command line, quoted if it needs to be.
#[must_use]
pub fn shell_word(path: &Path) -> String {
    let text = path.display().to_string();
    let is_plain = |c: char| c.is_ascii_alphanumeric() || "/._-+:@%,=".contains(c);
    if !text.is_empty() && text.chars().all(is_plain) {
        text
    } else {
        format!("'{}'", text.replace('\'', "'\\''"))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_path_is_one_word_of_a_shell() {
        assert_eq!(shell_word(Path::new("recordings/a-1")), "recordings/a-1");
        assert_eq!(shell_word(Path::new("a b's")), "'a b'\\''s'");
        assert_eq!(shell_word(Path::new("$(x)")), "'$(x)'");
    }
}
