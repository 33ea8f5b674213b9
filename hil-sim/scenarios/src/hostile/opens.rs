//! What a traced command opened, made, changed or removed outside of its folder, by the
//! lines of `strace -f -y`.
//!
//! A name is judged twice: as the program gave it, and an open file as the kernel found it,
//! behind all links. The system's own folders may be read. Looks (`stat`, `readlink`) are
//! no opens.

use std::path::{Component, Path, PathBuf};

/// The calls that are looked at; those with `?` may be missing on a processor.
pub(super) const CALLS: &str = "?open,openat,?openat2,?creat,?mkdir,mkdirat,?mknod,mknodat,\
    ?unlink,unlinkat,?rmdir,?rename,?renameat,?renameat2,?link,linkat,?symlink,symlinkat,\
    truncate,?chmod,fchmodat,?chown,?lchown,fchownat,?execve,?execveat";

/// Where anybody may read.
const SYSTEM: [&str; 8] = [
    "/usr", "/lib", "/lib64", "/bin", "/etc", "/proc", "/sys", "/dev",
];

/// The devices that anybody may write.
const DEVICES: [&str; 2] = ["/dev/null", "/dev/tty"];

/// The lines of `log` that lead out of `folder`, with what they lead to. `program` may be
/// run, and `ffmpeg`.
pub(super) fn strays(log: &str, folder: &Path, program: &Path) -> Vec<String> {
    let mut strays: Vec<String> = log
        .lines()
        .flat_map(|line| {
            let line = line.trim_start_matches(|c: char| c.is_ascii_digit() || c == ' ');
            targets(line, folder)
                .into_iter()
                .filter(|(path, kind)| !is_allowed(path, *kind, folder, program))
                .map(|(path, kind)| format!("{kind:?} {}", path.display()))
                .collect::<Vec<_>>()
        })
        .collect();
    strays.sort();
    strays.dedup();
    strays
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Kind {
    Read,
    Write,
    Run,
}

fn is_allowed(path: &Path, kind: Kind, folder: &Path, program: &Path) -> bool {
    let is_system = SYSTEM.iter().any(|system| path.starts_with(system));
    let tool = path
        .file_name()
        .is_some_and(|name| name == "ffmpeg" || name == "ffprobe" || name == "prlimit");
    match kind {
        _ if path.starts_with(folder) => true,
        Kind::Read => is_system || path == program,
        Kind::Write => DEVICES.iter().any(|device| path == Path::new(device)),
        // Each folder of PATH is tried.
        Kind::Run => path == program || tool,
    }
}

/// The absolute paths that a call is about.
fn targets(line: &str, folder: &Path) -> Vec<(PathBuf, Kind)> {
    let mut all = Vec::new();
    if let Some((_, result)) = line.rsplit_once(" = ")
        && let Some(found) = result
            .split_once("</")
            .and_then(|(_, rest)| rest.strip_suffix('>'))
    {
        // The kernel gives it without links; what for is known where the call is whole.
        let kind = kind_of(line);
        all.push((PathBuf::from(format!("/{found}")), kind));
    }
    // The second half of a call that was interrupted has no names.
    let Some((name, arguments)) = line.split_once('(') else {
        return all;
    };
    if name.contains(' ') {
        return all;
    }
    let mut base = folder.to_owned();
    for (before, text) in quoted(arguments) {
        // `5</some/folder>, "name"`, also for AT_FDCWD.
        if let Some((_, inside)) = before.split_once("</") {
            let inside = inside.rsplit_once('>').map_or(inside, |(inside, _)| inside);
            base = PathBuf::from(format!("/{inside}"));
        }
        all.push((plain(&base.join(text)), kind_of(line)));
        if name.starts_with("exec") {
            // What follows are arguments.
            break;
        }
    }
    all
}

fn kind_of(line: &str) -> Kind {
    let opens = line.starts_with("open") || line.starts_with("<... open");
    let writes = ["O_WRONLY", "O_RDWR", "O_CREAT", "O_TRUNC"];
    if line.starts_with("exec") {
        Kind::Run
    } else if opens && !writes.iter().any(|flag| line.contains(flag)) {
        Kind::Read
    } else {
        Kind::Write
    }
}

/// The texts in quotes, each with what stands between it and the one before.
fn quoted(arguments: &str) -> Vec<(&str, String)> {
    let mut all = Vec::new();
    let mut rest = arguments;
    while let Some((before, after)) = rest.split_once('"') {
        let mut text = String::new();
        let mut chars = after.char_indices();
        let mut end = after.len();
        while let Some((at, c)) = chars.next() {
            match c {
                '"' => {
                    end = at + 1;
                    break;
                }
                '\\' => text.extend(chars.next().map(|(_, c)| c)),
                c => text.push(c),
            }
        }
        all.push((before, text));
        rest = after.get(end..).unwrap_or_default();
    }
    all
}

/// Without `.` and `..`.
fn plain(path: &Path) -> PathBuf {
    let mut out = PathBuf::new();
    for part in path.components() {
        match part {
            Component::ParentDir => drop(out.pop()),
            Component::CurDir => {}
            part => out.push(part),
        }
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_leads_out_of_the_folder_is_named() {
        let log = r#"
7 execve("/opt/tool", ["/opt/tool", "verify", "/case/bait/x"], 0x7ffc /* 9 vars */) = 0
7 openat(AT_FDCWD</case/inside>, "/etc/ld.so.cache", O_RDONLY|O_CLOEXEC) = 3</etc/ld.so.cache>
7 openat(AT_FDCWD</case/inside>, "walk/recording.mcap", O_RDONLY) = 4</case/inside/walk/recording.mcap>
8 openat(AT_FDCWD</case/inside>, "out/a", O_WRONLY|O_CREAT, 0666) = 4</case/inside/out/a>
8 openat(5</case/inside/out>, "../b", O_RDONLY <unfinished ...>
8 <... openat resumed>)             = 5</case/inside/b>
7 +++ exited with 0 +++
"#;
        let (folder, program) = (Path::new("/case/inside"), Path::new("/opt/tool"));
        assert_eq!(strays(log, folder, program), Vec::<String>::new());
        for (line, told) in [
            (
                r#"7 openat(AT_FDCWD</case/inside>, "walk/link", O_RDONLY) = 3</case/bait/x>"#,
                "Read /case/bait/x",
            ),
            (
                r#"7 openat(AT_FDCWD</case/inside>, "../bait/x", O_RDONLY) = -1 ENOENT (No such file)"#,
                "Read /case/bait/x",
            ),
            (
                r#"7 openat(5</case/inside/out>, "../../n\"e", O_RDONLY <unfinished ...>"#,
                "Read /case/n\"e",
            ),
            (
                r#"7 <... openat resumed>)             = 5</home/me/.ssh/id>"#,
                "Read /home/me/.ssh/id",
            ),
            (
                r#"7 mkdir("/case/bait/new", 0777) = 0"#,
                "Write /case/bait/new",
            ),
            (r#"7 rename("/case/inside/a", "../../a") = 0"#, "Write /a"),
            (
                r#"7 openat(AT_FDCWD</case/inside>, "/usr/x", O_RDWR) = -1 EACCES (Permission denied)"#,
                "Write /usr/x",
            ),
            (r#"7 execve("/bin/sh", ["sh"], 0x1) = 0"#, "Run /bin/sh"),
        ] {
            assert_eq!(strays(line, folder, program), [told], "{line}");
        }
    }
}
