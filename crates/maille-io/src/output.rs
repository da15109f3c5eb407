//! Output files that appear whole or not at all.

use std::fs::{self, File};
use std::io::{self, BufWriter, Write};
use std::path::{Path, PathBuf};

use maille::Control;
use tempfile::NamedTempFile;

use crate::WriteError;

/// Bytes collected before they go to the file.
const BUFFER: usize = 1 << 18;

/// A file under work, written through a buffer. Once the caller cancels, writing fails.
pub(crate) type Stream<'a> = BufWriter<Guarded<'a>>;

/// The file or files that a writer makes: temporary ones in the target's folder, renamed together at the end.
///
/// Dropped before [`commit`](Self::commit), by an error or a panic, it leaves nothing behind.
pub(crate) struct Output<'a> {
    target: PathBuf,
    control: Control<'a>,
    done: Vec<(NamedTempFile, PathBuf)>,
    warnings: Vec<String>,
}

/// What writing did.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct Written {
    /// Every file that was written, the one asked for first.
    pub files: Vec<PathBuf>,
    /// What the format could not hold, one sentence each, for the user.
    pub warnings: Vec<String>,
}

/// Writes to a file until cancelled.
pub(crate) struct Guarded<'a> {
    file: NamedTempFile,
    target: PathBuf,
    control: Control<'a>,
}

impl Write for Guarded<'_> {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        if self.control.is_cancelled() {
            return Err(io::Error::other("cancelled"));
        }
        self.file.write(bytes)
    }

    fn flush(&mut self) -> io::Result<()> {
        self.file.flush()
    }
}

impl<'a> Output<'a> {
    /// An output for the file `path`, in whose folder all other files will be.
    pub(crate) fn new(path: &Path, control: Control<'a>) -> Result<Self, WriteError> {
        // a link stays a link: what it points to is replaced
        let resolved = if path.is_symlink() { fs::canonicalize(path).ok() } else { None };
        let target = resolved.unwrap_or_else(|| path.to_owned());
        match fs::metadata(&target) {
            Ok(meta) if meta.is_dir() => Err(WriteError::new("this is a folder").with_remedy("name a file")),
            Ok(meta) if !meta.is_file() => {
                let message = "this is not a regular file, and output replaces files as a whole";
                Err(WriteError::new(message).with_remedy("name a file"))
            }
            _ => Ok(Self { target, control, done: Vec::new(), warnings: Vec::new() }),
        }
    }

    /// Where the main file will be.
    pub(crate) fn target(&self) -> &Path {
        &self.target
    }

    /// Begins the main file.
    pub(crate) fn main(&self) -> Result<Stream<'a>, WriteError> {
        self.begin(self.target.clone())
    }

    /// Begins a file beside the main one.
    pub(crate) fn beside(&self, name: &str) -> Result<Stream<'a>, WriteError> {
        let path = self.target.with_file_name(name);
        // beside an old result it is part of that; alone it may be part of anything
        if path.exists() && !self.target.exists() {
            let message = format!("{name} would be written, too, but is there already and may belong to another model");
            return Err(WriteError::new(message).with_remedy("remove it, or choose another name or folder"));
        }
        self.begin(path)
    }

    /// Notes what the user should know of the result.
    pub(crate) fn warn(&mut self, warning: String) {
        self.warnings.push(warning);
    }

    fn begin(&self, target: PathBuf) -> Result<Stream<'a>, WriteError> {
        let folder = target.parent().filter(|p| !p.as_os_str().is_empty()).unwrap_or(Path::new("."));
        if !folder.is_dir() {
            let message = format!("there is no folder {}", folder.display());
            return Err(WriteError::new(message).with_remedy("create it first"));
        }
        let mut builder = tempfile::Builder::new();
        builder.prefix(".maille-").suffix(".part");
        #[cfg(unix)]
        {
            // as any new file: readable as far as the user's umask allows, not only by its owner
            use std::os::unix::fs::PermissionsExt;
            builder.permissions(fs::Permissions::from_mode(0o666));
        }
        let file = builder.tempfile_in(folder)?;
        Ok(BufWriter::with_capacity(BUFFER, Guarded { file, target, control: self.control }))
    }

    /// Takes a file whose content is complete.
    pub(crate) fn finish(&mut self, stream: Stream<'a>) -> Result<(), WriteError> {
        let Guarded { file, target, .. } = stream.into_inner().map_err(|e| WriteError::from(e.into_error()))?;
        self.done.push((file, target));
        Ok(())
    }

    /// Gives all finished files their names, the main one last.
    pub(crate) fn commit(mut self) -> Result<Written, WriteError> {
        if self.control.is_cancelled() {
            return Err(io::Error::other("cancelled").into());
        }
        self.done.sort_by_key(|(_, target)| *target == self.target);
        let mut files = Vec::with_capacity(self.done.len());
        for (file, target) in self.done {
            let _: File = file.persist(&target).map_err(|e| WriteError::from(e.error))?;
            files.push(target);
        }
        files.rotate_right(1);
        Ok(Written { files, warnings: self.warnings })
    }
}
