//! Progress bars on stderr for whatever takes longer than a second.

use std::io::IsTerminal;
use std::sync::Mutex;
use std::sync::mpsc::{self, RecvTimeoutError, Sender};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use indicatif::{ProgressBar, ProgressDrawTarget, ProgressStyle};

/// Stages shorter than this show nothing.
const PATIENCE: Duration = Duration::from_secs(1);
const STEPS: u64 = 1000;

/// The bar of the current stage, if any.
pub(crate) struct Progress {
    visible: bool,
    stage: Mutex<Option<Stage>>,
}

struct Stage {
    name: String,
    start: Instant,
    bar: Option<ProgressBar>,
}

impl Progress {
    /// Bars are shown when stderr is a terminal and the user did not ask for quiet.
    pub(crate) fn new(quiet: bool) -> Self {
        Self { visible: !quiet && std::io::stderr().is_terminal(), stage: Mutex::new(None) }
    }

    /// Shows that a share (0 to 1) of a stage is done.
    pub(crate) fn report(&self, name: &str, done: f32) {
        let Ok(mut stage) = self.stage.lock() else { return };
        if !self.visible {
            return;
        }
        if stage.as_ref().is_none_or(|stage| stage.name != name) {
            *stage = Some(Stage { name: name.to_owned(), start: Instant::now(), bar: None });
        }
        if let Some(stage) = stage.as_mut() {
            stage.show(f64::from(done).clamp(0.0, 1.0));
        }
    }

    /// Ends the current stage and clears its bar.
    pub(crate) fn finish(&self) {
        if let Ok(mut stage) = self.stage.lock() {
            *stage = None;
        }
    }

    /// Shows a spinner until the result is dropped, for work that cannot tell how far it is.
    pub(crate) fn spinner(&self, message: String) -> Spinner {
        self.finish();
        if !self.visible {
            return Spinner(None);
        }
        let (stop, stopped) = mpsc::channel::<()>();
        let thread = std::thread::spawn(move || {
            if stopped.recv_timeout(PATIENCE) != Err(RecvTimeoutError::Timeout) {
                return;
            }
            let bar = ProgressBar::new_spinner().with_message(message);
            while stopped.recv_timeout(Duration::from_millis(100)) == Err(RecvTimeoutError::Timeout) {
                bar.tick();
            }
            bar.finish_and_clear();
        });
        Spinner(Some((stop, thread)))
    }
}

impl Stage {
    fn show(&mut self, done: f64) {
        let elapsed = self.start.elapsed();
        if elapsed < PATIENCE {
            return;
        }
        let bar = self.bar.get_or_insert_with(|| {
            let style = ProgressStyle::with_template("{prefix} [{bar:40}] {percent:>3}% {msg}");
            let bar = ProgressBar::with_draw_target(Some(STEPS), ProgressDrawTarget::stderr());
            bar.with_prefix(self.name.clone())
                .with_style(style.expect("the template is well-formed").progress_chars("=> "))
        });
        bar.set_message(if done > 0.0 {
            format!("{:.0} s left", elapsed.as_secs_f64() * (1.0 - done) / done)
        } else {
            String::new()
        });
        bar.set_position((done * STEPS as f64) as u64);
    }
}

impl Drop for Stage {
    fn drop(&mut self) {
        if let Some(bar) = &self.bar {
            bar.finish_and_clear();
        }
    }
}

/// Clears the spinner when dropped.
pub(crate) struct Spinner(Option<(Sender<()>, JoinHandle<()>)>);

impl Drop for Spinner {
    fn drop(&mut self) {
        if let Some((stop, thread)) = self.0.take() {
            drop(stop);
            // a spinner that panicked has nothing left to clear
            let _ = thread.join();
        }
    }
}
