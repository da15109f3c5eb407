//! Time and memory of the stages of a command.

use std::time::Instant;

use maille::StageTimes;
use serde_json::{Value, json};

use crate::failure::Failure;
use crate::system;

/// What has been done so far.
pub(crate) struct Ledger {
    stages: Vec<Stage>,
    apart: bool,
    /// Memory that was held at the end of the last stage.
    held: Option<u64>,
}

/// One stage.
pub(crate) struct Stage {
    pub(crate) name: &'static str,
    pub(crate) seconds: f64,
    /// Most memory of the process while it ran, or up to its end; `None` where the system does not tell.
    pub(crate) peak_bytes: Option<u64>,
    /// The stages that it consists of, with their seconds.
    pub(crate) parts: Vec<(&'static str, f64)>,
}

impl Ledger {
    /// Opens the book. `apart`: the memory of each stage is measured on its own, where the system can.
    pub(crate) fn new(apart: bool) -> Self {
        Self { stages: Vec::new(), apart, held: None }
    }

    /// Does the work of a stage. What is held by then and was not at the end of the stage before belongs to none (a
    /// report), and is not counted.
    pub(crate) fn stage<T>(
        &mut self,
        name: &'static str,
        work: impl FnOnce(&StageTimes) -> Result<T, Failure>,
    ) -> Result<T, Failure> {
        let mut foreign = 0;
        if self.apart {
            system::reset_peak();
            let before = self.held.or_else(system::held_bytes);
            foreign = system::held_bytes().zip(before).map_or(0, |(now, before)| now.saturating_sub(before));
        }
        let (times, start) = (StageTimes::default(), Instant::now());
        let result = work(&times)?;
        let parts = times.stages().into_iter().map(|(name, time)| (name, time.as_secs_f64())).collect();
        let seconds = start.elapsed().as_secs_f64();
        let peak_bytes = system::peak_bytes().map(|peak| peak.saturating_sub(foreign));
        self.held = system::held_bytes();
        self.stages.push(Stage { name, seconds, peak_bytes, parts });
        Ok(result)
    }

    /// The stages in their order.
    pub(crate) fn stages(&self) -> &[Stage] {
        &self.stages
    }

    /// Seconds of a stage, 0 if it has not been there.
    pub(crate) fn seconds(&self, name: &str) -> f64 {
        self.stages.iter().find(|stage| stage.name == name).map_or(0.0, |stage| stage.seconds)
    }

    /// Most memory over the stages.
    pub(crate) fn peak_bytes(&self) -> Option<u64> {
        self.stages.iter().map(|stage| stage.peak_bytes).max().flatten()
    }

    pub(crate) fn json(&self) -> Vec<Value> {
        let part = |&(name, seconds): &(&str, f64)| json!({ "name": name, "seconds": seconds });
        let stage = |stage: &Stage| {
            json!({
                "name": stage.name,
                "seconds": stage.seconds,
                "peak_bytes": stage.peak_bytes,
                "parts": stage.parts.iter().map(part).collect::<Vec<_>>(),
            })
        };
        self.stages.iter().map(stage).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_stage_knows_its_parts() {
        let mut ledger = Ledger::new(true);
        let done = ledger.stage("work", |times| {
            let control = maille::Control::default().with_times(times);
            Ok(control.time("part", || 7))
        });
        assert_eq!(done.ok(), Some(7));
        let work = &ledger.stages()[0];
        assert!(work.parts.len() == 1 && work.parts[0].0 == "part" && work.parts[0].1 <= work.seconds);
        assert_eq!((ledger.seconds("work"), ledger.seconds("rest")), (work.seconds, 0.0));
    }
}
