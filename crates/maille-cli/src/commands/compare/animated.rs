//! `maille compare --animated`: distances over the clips that both files have.

use std::path::Path;

use maille::Mesh;
use maille::measure::{CompareError, CompareOptions, Comparison, compare};
use maille::skin::Clip;
use maille_io::{Asset, Format};
use serde_json::{Map, Value, json};

use super::page;
use crate::args::CompareArgs;
use crate::commands::report::ReportFiles;
use crate::failure::Failure;
use crate::output::{self, Listing, number};
use crate::session::Session;

/// Points sampled on each surface in each frame, where the user does not say.
const SAMPLES: u64 = 100_000;
/// Frames of all clips together, and the fewest of one, where the user does not say.
const FRAMES: usize = 24;
const FEWEST_FRAMES: usize = 2;
/// Seconds by which two clips may differ in start and end and still be the same one under another name.
const SAME_TIME: f64 = 1e-3;

pub(super) fn run(args: &CompareArgs) -> Result<(), Failure> {
    let files = match &args.report {
        Some(report) => Some(ReportFiles::new(report, &[&args.a, &args.b])?),
        None => None,
    };
    let session = Session::start(&args.common)?;
    let (a, b) = (session.read(&args.a)?, session.read(&args.b)?);
    for (path, asset) in [(&args.a, &a), (&args.b, &b)] {
        check_clips(path, asset)?;
    }
    let matching = Matching::of(a.clips(), b.clips());
    if matching.pairs.is_empty() {
        let message = format!(
            "none of its clips ({}) is one of {} ({}); give them the same names, or compare at rest, without --animated",
            names(a.clips(), |_| true),
            args.b.display(),
            names(b.clips(), |_| true),
        );
        return Err(Failure::about(&args.a, message));
    }
    matching.notes(&a, &b).iter().for_each(|note| session.note(note));
    let measured = Measured::new(args, &session, &a, &b, &matching)?;
    session.checkpoint()?;
    let mut told = measured.json(args, &session);
    if let Some(files) = &files {
        told.insert("report".to_owned(), args.report.as_ref().map(|path| path.display().to_string()).into());
        told.insert("files".to_owned(), output::paths(&files.files()).into());
        files.write(&session, &page::page(args, &measured), &Value::Object(told.clone()))?;
    }
    session.result(|| Value::Object(told), || measured.text(args, files.as_ref()))
}

/// Refuses a file that nothing moves in.
fn check_clips(path: &Path, asset: &Asset) -> Result<(), Failure> {
    if !asset.clips().is_empty() {
        return Ok(());
    }
    let remedy = match Format::from_path(path) {
        Some(Format::Gltf | Format::Glb) => "export it with its animations, or compare at rest, without --animated",
        _ => "only glTF and GLB hold them; give such files, or compare at rest, without --animated",
    };
    Err(Failure::about(path, format!("the file has no animation clips ({remedy})")))
}

/// The names of some clips, in quotes.
fn names(clips: &[Clip], which: impl Fn(usize) -> bool) -> String {
    let chosen = clips.iter().enumerate().filter(|(i, _)| which(*i));
    chosen.map(|(_, clip)| format!("'{}'", clip.name)).collect::<Vec<_>>().join(", ")
}

/// Which clips are the same.
#[derive(Debug, PartialEq)]
struct Matching {
    /// A clip of A and the same one of B, in the order of A.
    pairs: Vec<(usize, usize)>,
}

impl Matching {
    /// Clips of the same name; of several, the first with the first. What is left is the same under another name where it
    /// has the same place in the file and the same time.
    fn of(a: &[Clip], b: &[Clip]) -> Self {
        let mut partners: Vec<Option<usize>> = vec![None; a.len()];
        let mut taken = vec![false; b.len()];
        let mut pair = |i: usize, found: Option<usize>| {
            partners[i] = found;
            found.into_iter().for_each(|j| taken[j] = true);
        };
        for (i, clip) in a.iter().enumerate() {
            let earlier = a[..i].iter().filter(|other| other.name == clip.name).count();
            pair(i, (0..b.len()).filter(|&j| b[j].name == clip.name).nth(earlier));
        }
        for i in 0..a.len().min(b.len()) {
            if partners[i].is_none() && !taken[i] && is_same_time(&a[i], &b[i]) {
                partners[i] = Some(i);
            }
        }
        Self { pairs: partners.into_iter().enumerate().filter_map(|(i, j)| Some((i, j?))).collect() }
    }

    /// What the user should know of clips that are not quite the same, or have no partner.
    fn notes(&self, a: &Asset, b: &Asset) -> Vec<String> {
        let mut notes = Vec::new();
        for (i, j) in &self.pairs {
            let (ours, theirs) = (&a.clips()[*i], &b.clips()[*j]);
            if ours.name != theirs.name {
                notes.push(format!("the clip '{}' of A is compared with '{}' of B", ours.name, theirs.name));
            } else if !is_same_time(ours, theirs) {
                let time = |clip: &Clip| format!("{} to {} s", number(clip.start()), number(clip.end()));
                let times = format!("{} in A and {} in B", time(ours), time(theirs));
                notes.push(format!("the clip '{}' goes from {times}; it is compared over the time of A", ours.name));
            }
        }
        for (side, lonely) in [("A", self.only_a(a)), ("B", self.only_b(b))] {
            if !lonely.is_empty() {
                notes.push(format!("only {side} has the clips {lonely}, which are left out"));
            }
        }
        notes
    }

    fn only_a(&self, a: &Asset) -> String {
        names(a.clips(), |i| self.pairs.iter().all(|pair| pair.0 != i))
    }

    fn only_b(&self, b: &Asset) -> String {
        names(b.clips(), |j| self.pairs.iter().all(|pair| pair.1 != j))
    }
}

fn is_same_time(a: &Clip, b: &Clip) -> bool {
    (a.start() - b.start()).abs() <= SAME_TIME && (a.end() - b.end()).abs() <= SAME_TIME
}

/// The times of frames, in seconds: the middles of equal parts of a clip, so that each stands for as much of it and a clip
/// that loops does not show its ends twice. One for a clip that does not last.
fn frame_times(start: f64, end: f64, frames: usize) -> Vec<f64> {
    let frames = if end > start { frames } else { 1 };
    (0..frames).map(|frame| start + (end - start) * (frame as f64 + 0.5) / frames as f64).collect()
}

/// Distances over everything that both files can do.
pub(super) struct Measured {
    pub(super) rest: Distances,
    pub(super) clips: Vec<MeasuredClip>,
    /// Points sampled on each surface in each frame.
    pub(super) samples: u64,
}

/// Distances over a clip.
pub(super) struct MeasuredClip {
    /// In A.
    pub(super) name: String,
    /// From the first key to the last, in seconds.
    pub(super) start: f64,
    pub(super) end: f64,
    pub(super) frames: Vec<Frame>,
}

/// Distances in a pose.
pub(super) struct Frame {
    pub(super) seconds: f64,
    pub(super) distances: Distances,
}

/// How far two surfaces are apart: the larger of both directions, in model units. Over several poses: the mean of means,
/// the root of the mean square, and the largest.
#[derive(Clone, Copy)]
pub(super) struct Distances {
    pub(super) mean: f64,
    pub(super) rms: f64,
    pub(super) max: f64,
    /// The same as shares of the diagonal of A in its pose; NaN where that is 0.
    pub(super) shares: [f64; 3],
    /// Of A in this pose; the longest of several.
    pub(super) diagonal: f64,
}

impl Distances {
    fn of(c: &Comparison) -> Self {
        let distances = [c.mean(), c.rms(), c.max()];
        let share = |distance| if c.diagonal > 0.0 { c.relative(distance) } else { f64::NAN };
        let [mean, rms, max] = distances;
        Self { mean, rms, max, shares: distances.map(share), diagonal: c.diagonal }
    }

    /// Of several poses, at least one, each counting as much.
    pub(super) fn over(poses: &[&Self]) -> Self {
        let mean = |of: &dyn Fn(&Self) -> f64| poses.iter().map(|pose| of(pose)).sum::<f64>() / poses.len() as f64;
        let rms = |of: &dyn Fn(&Self) -> f64| mean(&|pose| of(pose).powi(2)).sqrt();
        // a maximum that keeps what is not a number
        let larger = |a: f64, b: f64| if b <= a { a } else { b };
        let max = |of: &dyn Fn(&Self) -> f64| poses.iter().map(|pose| of(pose)).fold(0.0, larger);
        Self {
            mean: mean(&|pose| pose.mean),
            rms: rms(&|pose| pose.rms),
            max: max(&|pose| pose.max),
            shares: [mean(&|pose| pose.shares[0]), rms(&|pose| pose.shares[1]), max(&|pose| pose.shares[2])],
            diagonal: max(&|pose| pose.diagonal),
        }
    }

    fn json(&self) -> Map<String, Value> {
        let [mean, rms, max] = self.shares;
        let object = json!({
            "mean": self.mean,
            "rms": self.rms,
            "max": self.max,
            "mean_of_diagonal": mean,
            "rms_of_diagonal": rms,
            "max_of_diagonal": max,
            "diagonal": self.diagonal,
        });
        match object {
            Value::Object(map) => map,
            _ => unreachable!("it is written as an object"),
        }
    }

    /// Distances and their shares, as cells of a table.
    fn cells(&self) -> Vec<String> {
        let percent = |share: f64| if share.is_nan() { String::new() } else { format!("{}%", number(100.0 * share)) };
        let distances = [self.mean, self.rms, self.max];
        distances.into_iter().zip(self.shares).flat_map(|(x, share)| [number(x), percent(share)]).collect()
    }
}

impl Measured {
    fn new(args: &CompareArgs, session: &Session, a: &Asset, b: &Asset, matching: &Matching) -> Result<Self, Failure> {
        let options = super::sampling(args, SAMPLES);
        let each = (args.frames.map(|frames| frames as usize))
            .unwrap_or_else(|| FRAMES.div_ceil(matching.pairs.len()).max(FEWEST_FRAMES));
        let times = |clip: &Clip| frame_times(clip.start(), clip.end(), each);
        let total: usize = 1 + matching.pairs.iter().map(|&(i, _)| times(&a.clips()[i]).len()).sum::<usize>();
        let mut done = 0;
        let mut measure = |pose: Pose<'_>, a: &Mesh, b: &Mesh| {
            session.progress("measuring poses", done as f32 / total as f32);
            done += 1;
            pose.measure(args, session, a, b, &options)
        };
        let rest = measure(Pose::Rest, &a.merged_positions(), &b.merged_positions())?;
        let mut clips = Vec::new();
        for &(i, j) in &matching.pairs {
            let clip = &a.clips()[i];
            let (ours, theirs) = (a.animation(i), b.animation(j));
            let mut frames = Vec::new();
            for seconds in times(clip) {
                session.cancelled()?;
                let ours = a.merged_positions_of(&ours.instances_at(seconds));
                let theirs = b.merged_positions_of(&theirs.instances_at(seconds));
                let distances = measure(Pose::At { clip: &clip.name, seconds }, &ours, &theirs)?;
                frames.push(Frame { seconds, distances });
            }
            clips.push(MeasuredClip { name: clip.name.clone(), start: clip.start(), end: clip.end(), frames });
        }
        Ok(Self { rest, clips, samples: options.samples })
    }

    /// Over all frames of all clips; the rest pose is none of them.
    pub(super) fn all(&self) -> Distances {
        Distances::over(&self.frames().map(|(_, frame)| &frame.distances).collect::<Vec<_>>())
    }

    pub(super) fn frames(&self) -> impl Iterator<Item = (&MeasuredClip, &Frame)> + Clone {
        self.clips.iter().flat_map(|clip| clip.frames.iter().map(move |frame| (clip, frame)))
    }

    /// The frame where a figure is largest, the first of equal ones.
    pub(super) fn worst(&self, figure: fn(&Distances) -> f64) -> (&MeasuredClip, &Frame) {
        let mut frames = self.frames();
        let first = frames.next().expect("each clip has a frame");
        let larger = |x: &Frame, y: &Frame| figure(&x.distances) > figure(&y.distances);
        frames.fold(first, |worst, next| if larger(next.1, worst.1) { next } else { worst })
    }

    fn json(&self, args: &CompareArgs, session: &Session) -> Map<String, Value> {
        let place = |(clip, frame): (&MeasuredClip, &Frame)| {
            let mut object = frame.distances.json();
            object.insert("clip".to_owned(), clip.name.as_str().into());
            object.insert("seconds".to_owned(), frame.seconds.into());
            object
        };
        let frame = |frame: &Frame| {
            let mut object = Map::from_iter([("seconds".to_owned(), frame.seconds.into())]);
            object.extend(frame.distances.json());
            object
        };
        let clip = |clip: &MeasuredClip| {
            let mut object = Map::from_iter([("name".to_owned(), clip.name.as_str().into())]);
            object.insert("start".to_owned(), clip.start.into());
            object.insert("end".to_owned(), clip.end.into());
            object.extend(clip.distances().json());
            object.insert("frames".to_owned(), clip.frames.iter().map(frame).collect());
            Value::Object(object)
        };
        let mut object = Map::new();
        object.insert("a".to_owned(), args.a.display().to_string().into());
        object.insert("b".to_owned(), args.b.display().to_string().into());
        object.extend(self.all().json());
        object.insert("worst".to_owned(), place(self.worst(|distances| distances.rms)).into());
        object.insert("farthest".to_owned(), place(self.worst(|distances| distances.max)).into());
        object.insert("rest".to_owned(), self.rest.json().into());
        object.insert("clips".to_owned(), self.clips.iter().map(clip).collect());
        object.insert("samples".to_owned(), self.samples.into());
        object.insert("seed".to_owned(), args.seed.into());
        object.insert("threads".to_owned(), session.threads().into());
        object.insert("report".to_owned(), Value::Null);
        object.insert("files".to_owned(), Value::Array(Vec::new()));
        object
    }

    fn text(&self, args: &CompareArgs, files: Option<&ReportFiles>) -> String {
        let mut text = format!("A  {}\nB  {}\n\n", args.a.display(), args.b.display());
        text += &output::table(&self.rows());
        let mut listing = Listing::default();
        listing.heading("");
        let (clip, frame) = self.worst(|distances| distances.rms);
        let rms = output::distance(frame.distances.rms, frame.distances.diagonal);
        listing.line("worst frame", format!("{}: RMS {rms}", page::moment(clip, frame)));
        let (clip, frame) = self.worst(|distances| distances.max);
        let max = output::distance(frame.distances.max, frame.distances.diagonal);
        listing.line("farthest", format!("{}: {max}", page::moment(clip, frame)));
        let points = output::count(self.samples);
        let seed = args.seed;
        listing
            .line("sampling", format!("in each frame {points} points on each surface and all vertices, seed {seed}"));
        if let Some(files) = files {
            listing.line("report", output::written(&files.files()));
        }
        text + &listing.text()
    }

    /// The table: the rest pose, each clip, all frames.
    fn rows(&self) -> Vec<Vec<String>> {
        let row = |name: &str, time: String, frames: usize, distances: Distances| {
            let mut row = vec![name.to_owned(), time, output::count(frames)];
            row.extend(distances.cells());
            row
        };
        let head = ["clip", "seconds", "frames", "mean", "of diagonal", "RMS", "of diagonal", "largest", "of diagonal"];
        let mut rows = vec![head.map(str::to_owned).to_vec()];
        rows.push(row("(at rest)", String::new(), 1, self.rest));
        rows.extend(self.clips.iter().map(|clip| row(&clip.name, clip.time(), clip.frames.len(), clip.distances())));
        rows.push(row("(all frames)", String::new(), self.frames().count(), self.all()));
        rows
    }
}

impl MeasuredClip {
    pub(super) fn distances(&self) -> Distances {
        Distances::over(&self.frames.iter().map(|frame| &frame.distances).collect::<Vec<_>>())
    }

    /// From when to when, in seconds.
    pub(super) fn time(&self) -> String {
        format!("{} to {}", number(self.start), number(self.end))
    }
}

/// What is being measured, for messages.
#[derive(Clone, Copy)]
enum Pose<'a> {
    Rest,
    At { clip: &'a str, seconds: f64 },
}

impl Pose<'_> {
    fn measure(
        self,
        args: &CompareArgs,
        session: &Session,
        a: &Mesh,
        b: &Mesh,
        options: &CompareOptions,
    ) -> Result<Distances, Failure> {
        let comparison = compare(a, b, options, session.quiet_control());
        comparison.map(|c| Distances::of(&c)).map_err(|error| match (self, &error) {
            (Self::At { clip, seconds }, CompareError::NotFinite { .. }) => {
                Failure::Refused(format!("in the clip '{clip}' at {} s {error}", number(seconds)))
            }
            _ => super::refusal(args, &error),
        })
    }
}

#[cfg(test)]
mod tests {
    use maille::skin::{Channel, Interpolation, Keys};

    use super::*;

    fn clip(name: &str, end: f32) -> Clip {
        let keys = Keys::Scale(vec![[1.0; 3]; 2]);
        let channel = Channel { joint: 0, times: vec![0.0, end], interpolation: Interpolation::Linear, keys };
        Clip { name: name.to_owned(), channels: vec![channel] }
    }

    #[test]
    fn clips_are_matched_by_name_then_by_place_and_time() {
        let pairs = |a: &[Clip], b: &[Clip]| Matching::of(a, b).pairs;
        let [walk, run, idle] = [clip("walk", 1.0), clip("run", 0.5), clip("idle", 4.0)];
        let ordered = [walk.clone(), run.clone()];
        let twice = [walk.clone(), walk.clone()];
        assert_eq!(pairs(&ordered, &[run.clone(), walk.clone()]), [(0, 1), (1, 0)]);
        assert_eq!((pairs(&twice, &twice), pairs(&twice, &twice[..1])), (vec![(0, 0), (1, 1)], vec![(0, 0)]));
        // another name, but the same place and time
        assert_eq!(pairs(&ordered, &[walk.clone(), clip("Run", 0.5)]), [(0, 0), (1, 1)]);
        assert_eq!(pairs(&twice[..1], &[clip("Walk", 1.5)]), []);
        // the place is another clip's already
        assert_eq!(pairs(&[idle, walk.clone()], &[walk, clip("stand", 4.0)]), [(1, 0)]);
        assert_eq!(pairs(&[run], &[]), []);
    }

    #[test]
    fn frames_stand_for_equal_parts() {
        assert_eq!(frame_times(1.0, 3.0, 4), [1.25, 1.75, 2.25, 2.75]);
        assert_eq!(frame_times(2.0, 2.0, 24), [2.0]);
    }

    #[test]
    fn figures_over_poses_are_those_of_all_their_points() {
        let pose = |x: f64, diagonal: f64| Distances {
            mean: x,
            rms: 2.0 * x,
            max: 3.0 * x,
            shares: [x / diagonal, 2.0 * x / diagonal, 3.0 * x / diagonal],
            diagonal,
        };
        let over = Distances::over(&[&pose(1.0, 10.0), &pose(7.0, 100.0)]);
        assert_eq!((over.mean, over.rms, over.max, over.diagonal), (4.0, 10.0, 21.0, 100.0));
        assert!((over.shares[0] - 0.085).abs() < 1e-12 && (over.shares[2] - 0.3).abs() < 1e-12);
        assert!((over.shares[1] - (0.2_f64.powi(2) + 0.14_f64.powi(2)).sqrt() / 2_f64.sqrt()).abs() < 1e-12);
        let flat = Distances { shares: [f64::NAN; 3], diagonal: 0.0, ..pose(0.0, 1.0) };
        assert!(Distances::over(&[&flat, &flat]).shares[2].is_nan());
    }
}
