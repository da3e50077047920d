//! Decides whether two names lead to the same file.

use std::path::Path;

use super::{is_dash, is_stdout};
use crate::file_of;

/// Returns whether writing `output` would change `input`: both are the same file, under whatever names; the input
/// is a place inside the output; or the input is a folder that contains the output. `-` is the file that stdin or
/// stdout leads to.
#[must_use]
pub fn is_same(input: &Path, output: &Path) -> bool {
    let input = match is_dash(input) {
        true => Path::new("/dev/stdin"),
        false => file_of(input),
    };
    let output = match is_stdout(output) {
        true => Path::new("/dev/stdout"),
        false => file_of(output),
    };
    let Some(of_input) = Identity::of(input) else {
        return false;
    };
    if input.is_dir() {
        let output = std::path::absolute(output);
        let output = output.as_deref().unwrap_or(Path::new(""));
        let mut folders = output.ancestors();
        return folders.any(|folder| Identity::of(folder).as_ref() == Some(&of_input));
    }
    // Reading and writing the same terminal or /dev/null destroys nothing.
    let is_file = std::fs::metadata(input).is_ok_and(|metadata| metadata.is_file());
    is_file && Identity::of(output) == Some(of_input)
}

/// Returns whether two outputs, which need not exist, would be one file: the same name in the same folder, however it is
/// spelled and through whatever links.
#[must_use]
pub fn is_one_output(a: &Path, b: &Path) -> bool {
    let place = |path: &Path| {
        let target = super::target(path).ok()?;
        let folder = super::folder(&target).canonicalize().ok()?;
        Some(folder.join(target.file_name()?))
    };
    a == b || is_same(a, b) || place(a).is_some_and(|of_a| place(b) == Some(of_a))
}

/// The identity of a file, which does not depend on its names.
#[derive(PartialEq, Eq)]
struct Identity(
    #[cfg(unix)] (u64, u64),
    #[cfg(not(unix))] std::path::PathBuf,
);

impl Identity {
    #[cfg(unix)]
    fn of(path: &Path) -> Option<Self> {
        use std::os::unix::fs::MetadataExt;
        let metadata = std::fs::metadata(path).ok()?;
        Some(Self((metadata.dev(), metadata.ino())))
    }

    #[cfg(not(unix))]
    fn of(path: &Path) -> Option<Self> {
        path.canonicalize().ok().map(Self)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn one_file_is_found_under_every_name() {
        let folder = tempfile::tempdir().unwrap();
        let at = |name: &str| folder.path().join(name);
        std::fs::write(at("a.raw"), "events").unwrap();
        std::fs::hard_link(at("a.raw"), at("hard.raw")).unwrap();
        std::fs::create_dir(at("bag")).unwrap();
        std::fs::write(at("bag/metadata.yaml"), "").unwrap();
        #[cfg(unix)]
        std::os::unix::fs::symlink("a.raw", at("link.raw")).unwrap();
        for (input, output, same) in [
            ("a.raw", "a.raw", true),
            ("a.raw", "./a.raw", true),
            ("a.raw", "bag/../a.raw", true),
            ("a.raw", "hard.raw", true),
            ("a.raw", "b.raw", false),
            ("a.raw/davis/left/events", "a.raw", true),
            ("bag", "bag/metadata.yaml", true),
            ("bag", "bag/new.raw", true),
            ("bag/topic", "bag/metadata.yaml", true),
            ("bag", "new.raw", false),
            #[cfg(unix)]
            ("a.raw", "link.raw", true),
            #[cfg(unix)]
            ("link.raw", "hard.raw", true),
        ] {
            assert_eq!(is_same(&at(input), &at(output)), same, "{input} {output}");
        }
        let open = std::fs::File::open(at("a.raw")).unwrap();
        #[cfg(target_os = "linux")]
        {
            use std::os::fd::AsRawFd;
            let name = format!("/proc/self/fd/{}", open.as_raw_fd());
            assert!(is_same(&at("a.raw"), Path::new(&name)));
        }
        drop(open);
    }

    #[test]
    fn outputs_that_are_not_there_are_found_under_every_name() {
        let folder = tempfile::tempdir().unwrap();
        let at = |name: &str| folder.path().join(name);
        std::fs::create_dir(at("in")).unwrap();
        #[cfg(unix)]
        for link in ["one", "two"] {
            std::os::unix::fs::symlink("c.npz", at(link)).unwrap();
        }
        for (a, b, same) in [
            ("c.npz", "c.npz", true),
            ("c.npz", "./c.npz", true),
            ("c.npz", "in/../c.npz", true),
            ("c.npz", "in/c.npz", false),
            ("c.npz", "d.npz", false),
            #[cfg(unix)]
            ("one", "two", true),
            #[cfg(unix)]
            ("c.npz", "in/../two", true),
        ] {
            assert_eq!(is_one_output(&at(a), &at(b)), same, "{a} {b}");
        }
    }
}
