//! Files that appear whole or not at all: written beside their destination, then renamed over it.

use std::fs;
use std::io::{self, Write as _};
use std::path::{Path, PathBuf};

/// Writes `bytes` to `path` so that a reader sees the old file or the whole new one, never a part.
///
/// A symbolic link is followed, also one whose file is yet to be made. What is neither a file nor absent (a pipe,
/// `/dev/null`) is written to directly: renaming over it would replace the device.
///
/// # Errors
/// Those of the operating system; the destination is then untouched and the temporary file removed.
pub fn write(path: &Path, bytes: &[u8]) -> io::Result<()> {
    let destination = match fs::metadata(path) {
        Ok(known) if known.is_dir() => return Err(io::ErrorKind::IsADirectory.into()),
        Ok(known) if !known.is_file() => return write_directly(path, bytes),
        Ok(_) => fs::canonicalize(path)?,
        Err(_) => end_of_links(path)?,
    };
    let directory = folder_of(&destination);
    let mut builder = tempfile::Builder::new();
    builder.prefix(".nacre-").suffix(".part");
    #[cfg(unix)]
    {
        use std::os::unix::fs::PermissionsExt as _;
        // As any newly created file: the umask takes its share (tempfile alone would make it 0600).
        builder.permissions(fs::Permissions::from_mode(0o666));
    }
    let mut part = builder.tempfile_in(directory).map_err(without_part)?;
    part.write_all(bytes).map_err(without_part)?;
    part.as_file().sync_all()?;
    part.persist(&destination).map_err(|error| error.error)?;
    #[cfg(unix)]
    {
        // The rename itself is durable only once the directory is; not every file system can say so.
        let _ = fs::File::open(directory).and_then(|directory| directory.sync_all());
    }
    Ok(())
}

/// Whether [`write()`] has somewhere to put `path`: finds out before the work what would end it after.
///
/// # Errors
/// Those of the operating system; nothing is left behind.
pub fn check(path: &Path) -> io::Result<()> {
    let destination = match fs::metadata(path) {
        Ok(known) if known.is_dir() => return Err(io::ErrorKind::IsADirectory.into()),
        Ok(known) if !known.is_file() => return fs::OpenOptions::new().write(true).open(path).map(drop),
        Ok(_) => fs::canonicalize(path)?,
        Err(_) => end_of_links(path)?,
    };
    let folder = folder_of(&destination);
    if !folder.is_dir() {
        return Err(io::Error::new(io::ErrorKind::NotFound, format!("{}: no such folder", folder.display())));
    }
    tempfile::NamedTempFile::new_in(folder).map(drop).map_err(without_part)
}

/// What went wrong, without the name of the temporary file that it went wrong with (tempfile puts it behind).
fn without_part(error: io::Error) -> io::Error {
    match error.to_string().split_once(" at path ") {
        Some((what, _)) => io::Error::new(error.kind(), what),
        None => error,
    }
}

/// Links that are followed before they count as a circle (as Linux does).
const MOST_LINKS: usize = 40;

/// What a path means that cannot be opened: where its links lead, if it is one.
///
/// # Errors
/// A circle of links, or a name that no file can have.
fn end_of_links(path: &Path) -> io::Result<PathBuf> {
    let mut end = path.to_owned();
    for _ in 0..MOST_LINKS {
        match fs::symlink_metadata(&end) {
            Ok(known) if known.is_symlink() => end = folder_of(&end).join(fs::read_link(&end)?),
            Err(error) if error.kind() == io::ErrorKind::InvalidFilename => return Err(error),
            _ => return Ok(end),
        }
    }
    Err(io::Error::other("a circle of symbolic links"))
}

/// Whether two paths name one and the same file that is there; devices do not count.
#[must_use]
pub fn same_file(a: &Path, b: &Path) -> bool {
    let file = |path: &Path| fs::canonicalize(path).ok().filter(|path| path.is_file());
    file(a).is_some_and(|a| file(b) == Some(a))
}

/// The folder of a file; `.` for a bare name.
fn folder_of(path: &Path) -> &Path {
    match path.parent() {
        Some(parent) if !parent.as_os_str().is_empty() => parent,
        _ => Path::new("."),
    }
}

fn write_directly(path: &Path, bytes: &[u8]) -> io::Result<()> {
    let mut device = fs::OpenOptions::new().write(true).open(path)?;
    device.write_all(bytes)?;
    device.flush()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn names(directory: &Path) -> Vec<String> {
        let mut names: Vec<String> =
            fs::read_dir(directory).unwrap().map(|e| e.unwrap().file_name().into_string().unwrap()).collect();
        names.sort();
        names
    }

    #[test]
    fn a_write_replaces_the_file_and_leaves_nothing_else() {
        let directory = tempfile::tempdir().unwrap();
        let path = directory.path().join("a.exr");
        write(&path, b"old").unwrap();
        write(&path, b"new").unwrap();
        assert_eq!(fs::read(&path).unwrap(), b"new");
        assert_eq!(names(directory.path()), ["a.exr"]);
    }

    #[test]
    fn a_failed_write_leaves_no_file() {
        let directory = tempfile::tempdir().unwrap();
        let absent = write(&directory.path().join("absent/a.exr"), b"x").unwrap_err();
        assert!(
            absent.kind() == io::ErrorKind::NotFound && !absent.to_string().contains(".part"),
            "{absent}"
        );
        assert!(write(directory.path(), b"x").is_err());
        assert!(names(directory.path()).is_empty());
    }

    #[cfg(unix)]
    #[test]
    fn links_are_followed_to_files_old_and_new() {
        use std::os::unix::fs::symlink;
        let directory = tempfile::tempdir().unwrap();
        let at = |name: &str| directory.path().join(name);
        symlink("new", at("first")).unwrap();
        symlink("first", at("second")).unwrap();
        for content in [b"old", b"new"] {
            check(&at("second")).unwrap();
            write(&at("second"), content).unwrap();
            assert_eq!(fs::read(at("new")).unwrap(), content);
        }
        symlink("b", at("a")).unwrap();
        symlink("a", at("b")).unwrap();
        for refused in [check(&at("a")), write(&at("a"), b"x")] {
            assert!(refused.unwrap_err().to_string().contains("circle"));
        }
        assert_eq!(names(directory.path()), ["a", "b", "first", "new", "second"]);
    }

    #[test]
    fn what_cannot_be_written_is_known_before() {
        let directory = tempfile::tempdir().unwrap();
        let refusal = |name: &str| check(&directory.path().join(name)).unwrap_err();
        let absent = refusal("absent/a.exr").to_string();
        assert!(absent.ends_with("absent: no such folder"), "{absent}");
        assert_eq!(refusal("").kind(), io::ErrorKind::IsADirectory);
        assert_eq!(refusal(&"x".repeat(300)).kind(), io::ErrorKind::InvalidFilename);
        #[cfg(target_os = "linux")]
        assert!(!check(Path::new("/proc/a.exr")).unwrap_err().to_string().contains(".tmp"));
        assert!(names(directory.path()).is_empty());
    }

    #[cfg(target_os = "linux")]
    #[test]
    fn a_device_is_written_to_and_not_replaced() {
        use std::os::unix::fs::FileTypeExt as _;
        write(Path::new("/dev/null"), b"x").unwrap();
        assert_eq!(write(Path::new("/dev/full"), b"x").unwrap_err().kind(), io::ErrorKind::StorageFull);
        assert!(fs::metadata("/dev/null").unwrap().file_type().is_char_device());
    }

    #[cfg(unix)]
    #[test]
    fn others_may_read_the_file_as_any_new_file() {
        use std::os::unix::fs::PermissionsExt as _;
        let directory = tempfile::tempdir().unwrap();
        let (ours, plain) = (directory.path().join("ours"), directory.path().join("plain"));
        write(&ours, b"x").unwrap();
        fs::write(&plain, b"x").unwrap();
        let mode = |path| fs::metadata(path).unwrap().permissions().mode();
        assert_eq!(mode(ours), mode(plain));
    }
}
