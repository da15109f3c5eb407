//! Progress and cancellation of long work.

use std::sync::Mutex;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

/// Called with the name of a stage and the share of it that is done, 0 to 1.
pub type Progress<'a> = &'a (dyn Fn(&str, f32) + Sync);

/// How a caller watches and stops a long computation.
///
/// Algorithms call [`report`](Self::report) at least a few times a second, from one thread at a time per stage, and
/// stop early when [`is_cancelled`](Self::is_cancelled) turns true. [`Control::default`] watches nothing.
///
/// ```
/// use std::sync::atomic::AtomicBool;
/// let stop = AtomicBool::new(false);
/// let print = |stage: &str, done: f32| assert!(!stage.is_empty() && done <= 1.0);
/// let control = maille::Control::new(Some(&print), Some(&stop));
/// control.report("collapsing edges", 0.5);
/// assert!(!control.is_cancelled());
/// ```
#[derive(Clone, Copy, Default)]
pub struct Control<'a> {
    progress: Option<Progress<'a>>,
    cancel: Option<&'a AtomicBool>,
    times: Option<&'a StageTimes>,
}

impl<'a> Control<'a> {
    /// A control that calls `progress` with the name of the stage and the share done (0 to 1), and stops once `cancel`
    /// is set.
    pub fn new(progress: Option<Progress<'a>>, cancel: Option<&'a AtomicBool>) -> Self {
        Self { progress, cancel, times: None }
    }

    /// The same way to stop, but progress goes to `progress`.
    #[must_use]
    pub fn with_progress<'b>(&self, progress: Progress<'b>) -> Control<'b>
    where
        'a: 'b,
    {
        Control { progress: Some(progress), ..*self }
    }

    /// The same, and how long each stage takes is added to `times`.
    #[must_use]
    pub fn with_times<'b>(&self, times: &'b StageTimes) -> Control<'b>
    where
        'a: 'b,
    {
        Control { times: Some(times), ..*self }
    }

    /// Does the work of a stage and takes its time, where somebody wants to know it.
    pub fn time<T>(&self, stage: &'static str, work: impl FnOnce() -> T) -> T {
        let Some(times) = self.times else { return work() };
        let start = Instant::now();
        let result = work();
        times.add(stage, start.elapsed());
        result
    }

    /// Tells that a share (0 to 1) of a stage is done.
    pub fn report(&self, stage: &str, done: f32) {
        if let Some(progress) = self.progress {
            progress(stage, done);
        }
    }

    /// Whether the caller wants the work to stop.
    pub fn is_cancelled(&self) -> bool {
        self.cancel.is_some_and(|cancel| cancel.load(Ordering::Relaxed))
    }
}

/// How long the stages of a computation took: what [`Control::with_times`] fills.
///
/// Kept apart from the reports of algorithms, which are the same on every run. Stages that run at the same time (several
/// meshes of an asset) add up, so their sum may be more than what a clock on the wall shows.
///
/// ```
/// let times = maille::StageTimes::default();
/// let control = maille::Control::default().with_times(&times);
/// assert_eq!(control.time("adding", || 1 + 1), 2);
/// assert_eq!(times.stages()[0].0, "adding");
/// ```
#[derive(Debug, Default)]
pub struct StageTimes {
    stages: Mutex<Vec<(&'static str, Duration)>>,
}

impl StageTimes {
    /// Names and times of the stages, in the order in which they first ended.
    pub fn stages(&self) -> Vec<(&'static str, Duration)> {
        self.stages.lock().map(|stages| stages.clone()).unwrap_or_default()
    }

    fn add(&self, stage: &'static str, time: Duration) {
        let Ok(mut stages) = self.stages.lock() else { return };
        match stages.iter_mut().find(|(known, _)| *known == stage) {
            Some((_, sum)) => *sum += time,
            None => stages.push((stage, time)),
        }
    }
}

/// The work was stopped by [`Control`]; nothing of its result is usable.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
#[error("cancelled")]
pub struct Cancelled;

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn times_of_a_stage_add_up_in_the_order_of_the_first() {
        let times = StageTimes::default();
        let control = Control::default().with_times(&times);
        for stage in ["one", "two", "one"] {
            control.time(stage, || std::thread::sleep(Duration::from_millis(2)));
        }
        let stages = times.stages();
        assert_eq!(stages.iter().map(|stage| stage.0).collect::<Vec<_>>(), ["one", "two"]);
        assert!(stages[0].1 >= Duration::from_millis(4) && stages[1].1 >= Duration::from_millis(2));
    }
}
