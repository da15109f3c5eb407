//! What every working command goes through: threads, progress, Ctrl-C, reading and writing.

use std::path::Path;
use std::sync::atomic::{AtomicBool, Ordering};

use maille::Control;
use maille_io::{Asset, ProgressiveAsset, ReadError, ReadOptions, WriteError, WriteOptions, Written};

use crate::args::Common;
use crate::failure::{Failure, say};
use crate::output;
use crate::progress::{Progress, Spinner};

/// Set by Ctrl-C; algorithms look at it through [`Control`].
static CANCELLED: AtomicBool = AtomicBool::new(false);
/// While true, nothing needs to be cleaned up, so that Ctrl-C may end the process at once.
static MAY_EXIT: AtomicBool = AtomicBool::new(false);

type Report = Box<dyn Fn(&str, f32) + Send + Sync>;

/// One run of a command.
pub(crate) struct Session {
    progress: std::sync::Arc<Progress>,
    report: Report,
    quiet: bool,
    json: bool,
}

impl Session {
    /// Builds the thread pool and takes over Ctrl-C. Once per process.
    pub(crate) fn start(common: &Common) -> Result<Self, Failure> {
        let threads = common.threads.map_or(0, usize::from);
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build_global();
        pool.map_err(|error| Failure::Refused(format!("cannot start the threads: {error}")))?;
        let handler = ctrlc::set_handler(|| {
            CANCELLED.store(true, Ordering::SeqCst);
            if MAY_EXIT.load(Ordering::SeqCst) {
                std::process::exit(1);
            }
        });
        handler.map_err(|error| Failure::Refused(format!("cannot listen to Ctrl-C: {error}")))?;
        let progress = std::sync::Arc::new(Progress::new(common.quiet));
        let shown = progress.clone();
        let report: Report = Box::new(move |stage, done| shown.report(stage, done));
        Ok(Self { progress, report, quiet: common.quiet, json: common.json })
    }

    /// Number of threads at work.
    pub(crate) fn threads(&self) -> usize {
        rayon::current_num_threads()
    }

    /// For the algorithms: shows their progress and stops them on Ctrl-C.
    pub(crate) fn control(&self) -> Control<'_> {
        Control::new(Some(&*self.report), Some(&CANCELLED))
    }

    /// For algorithms that are a small part of the work: stops them on Ctrl-C, shows nothing.
    pub(crate) fn quiet_control(&self) -> Control<'static> {
        Control::new(None, Some(&CANCELLED))
    }

    /// Shows how far work is that consists of several algorithms.
    pub(crate) fn progress(&self, stage: &str, done: f32) {
        self.progress.report(stage, done);
    }

    /// Stops here if Ctrl-C came.
    pub(crate) fn cancelled(&self) -> Result<(), Failure> {
        if CANCELLED.load(Ordering::SeqCst) { Err(Failure::Cancelled) } else { Ok(()) }
    }

    /// Clears the progress bar of what just ended and stops here if Ctrl-C came.
    pub(crate) fn checkpoint(&self) -> Result<(), Failure> {
        self.progress.finish();
        self.cancelled()
    }

    /// Shows that something is going on that cannot tell how far it is, until the result is dropped.
    pub(crate) fn spinner(&self, what: &str) -> Spinner {
        self.progress.spinner(what.to_owned())
    }

    /// Reads a file of any format and tells what was odd in it.
    pub(crate) fn read(&self, path: &Path) -> Result<Asset, Failure> {
        let asset = self.open(path)?;
        self.warn(path, &asset.warnings);
        Ok(asset)
    }

    /// Reads a file of any format; what was odd in it is left to the caller to tell.
    pub(crate) fn open(&self, path: &Path) -> Result<Asset, Failure> {
        self.reading(path, || maille_io::read(path, &ReadOptions::default()))
    }

    /// Reads a progressive mesh; what was odd in it is left to the caller to tell.
    pub(crate) fn open_progressive(&self, path: &Path) -> Result<ProgressiveAsset, Failure> {
        self.reading(path, || ProgressiveAsset::read(path, &ReadOptions::default()))
    }

    fn reading<T>(&self, path: &Path, read: impl FnOnce() -> Result<T, ReadError>) -> Result<T, Failure> {
        let spinner = self.progress.spinner(format!("reading {}", path.display()));
        MAY_EXIT.store(true, Ordering::SeqCst);
        let content = read();
        MAY_EXIT.store(false, Ordering::SeqCst);
        drop(spinner);
        let content = content?;
        self.checkpoint()?;
        Ok(content)
    }

    /// Writes a file whole or not at all, and tells what its format could not hold.
    pub(crate) fn write(&self, asset: &Asset, path: &Path, options: &WriteOptions) -> Result<Written, Failure> {
        self.writing(path, || maille_io::write_with(asset, path, options, self.control()))
    }

    /// Writes a progressive mesh, as [`write`](Self::write) does an asset.
    pub(crate) fn write_progressive(&self, progressive: &ProgressiveAsset, path: &Path) -> Result<Written, Failure> {
        self.writing(path, || progressive.write(path, self.control()))
    }

    fn writing(&self, path: &Path, write: impl FnOnce() -> Result<Written, WriteError>) -> Result<Written, Failure> {
        self.checkpoint()?;
        let spinner = self.progress.spinner(format!("writing {}", path.display()));
        let written = write();
        drop(spinner);
        if CANCELLED.load(Ordering::SeqCst) && written.is_err() {
            return Err(Failure::Cancelled);
        }
        let written = written?;
        self.warn(path, &written.warnings);
        Ok(written)
    }

    /// Writes bytes that are no mesh (a picture, a page) whole or not at all.
    pub(crate) fn write_bytes(&self, bytes: &[u8], path: &Path) -> Result<(), Failure> {
        self.write_together(&[(bytes, path)])
    }

    /// Writes several such files: all of them appear, or none.
    pub(crate) fn write_together(&self, files: &[(&[u8], &Path)]) -> Result<(), Failure> {
        self.checkpoint()?;
        let prepare = |bytes: &[u8], path: &Path| {
            let mut file = tempfile::NamedTempFile::new_in(folder_of(path))?;
            std::io::Write::write_all(&mut file, bytes)?;
            share_with_all(file.as_file())?;
            Ok(file)
        };
        let mut ready = Vec::new();
        for &(bytes, path) in files {
            ready.push((prepare(bytes, path).map_err(|error| Failure::writing(path, error))?, path));
        }
        for (file, path) in ready {
            file.persist(path).map_err(|error| Failure::writing(path, error.error))?;
        }
        Ok(())
    }

    /// Refuses a place where no file can be written, before any work is done for it.
    pub(crate) fn check_place(path: &Path) -> Result<(), Failure> {
        let trial = tempfile::NamedTempFile::new_in(folder_of(path));
        trial.map(drop).map_err(|error| Failure::writing(path, error))
    }

    /// Prints the result of the command: as JSON where that is asked for, else as text, where the user did not ask for
    /// quiet.
    pub(crate) fn result(
        &self,
        json: impl FnOnce() -> serde_json::Value,
        text: impl FnOnce() -> String,
    ) -> Result<(), Failure> {
        match (self.json, self.quiet) {
            (true, _) => output::print_json(&json())?,
            (false, false) => output::print(&text())?,
            (false, true) => {}
        }
        Ok(())
    }

    /// Tells the user what is to be known of a file beside the result.
    pub(crate) fn warn(&self, path: &Path, warnings: &[String]) {
        warnings.iter().for_each(|warning| self.note(&format!("{}: {warning}", path.display())));
    }

    /// Tells the user something beside the result.
    pub(crate) fn note(&self, message: &str) {
        if !self.quiet {
            say(message);
        }
    }
}

fn folder_of(path: &Path) -> &Path {
    path.parent().filter(|folder| !folder.as_os_str().is_empty()).unwrap_or(Path::new("."))
}

/// Temporary files are readable by their owner only; results are like any other file.
fn share_with_all(file: &std::fs::File) -> std::io::Result<()> {
    #[cfg(unix)]
    {
        use std::os::unix::fs::PermissionsExt;
        file.set_permissions(std::fs::Permissions::from_mode(0o644))?;
    }
    #[cfg(not(unix))]
    let _ = file;
    Ok(())
}
