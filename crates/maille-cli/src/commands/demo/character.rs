//! A character in levels of detail: how well they move, simplified in different ways, and how one melts into the next.

use std::path::Path;

use maille::measure::{CompareOptions, compare};
use maille::samples::Sample;
use maille_io::{
    Asset, GeomorphForm, Instance, LevelTarget, LodChain, LodOptions, PoseSet, WriteOptions, lod_chain, sample,
};
use serde_json::{Value, json};

use super::failed;
use crate::commands::report::{Look, Picture, Series, Studio, count, escape, film, linear, percent, table};
use crate::failure::Failure;
use crate::session::Session;

/// Triangles of the character.
const TRIANGLES: usize = 6_000;
const PERCENTS: [usize; 4] = [50, 25, 10, 3];
/// Which of the levels is measured.
const MEASURED: usize = 2;
/// Frames that are measured of each clip, and points on each surface.
const FRAMES: usize = 12;
const SAMPLES: u64 = 20_000;
/// Poses that stand for the clips.
const POSES: usize = 8;
/// Pictures of the film, of the way from the level before the last to the last one.
const PICTURES: usize = 6;
const PICTURE: (u32, u32) = (280, 400);
const VIEW: (f32, f32) = (25.0, 8.0);

/// What is told of the character.
pub(super) struct Character {
    triangles: usize,
    /// Of each level.
    levels: Vec<usize>,
    clips: Vec<Clip>,
    film: Vec<Picture>,
}

/// A clip, measured.
struct Clip {
    name: String,
    /// Of each way, seconds and root mean square distances as shares of the diagonal.
    frames: Vec<Vec<(f64, f64)>>,
}

/// Ways to simplify a character: name, and what they do.
const WAYS: [(&str, &str); 3] = [
    ("one pose", "looked at as its vertices are stored"),
    ("many poses", "looked at in poses that stand for its clips"),
    ("fitted", "that, and positions and weights of the joints fitted over these poses"),
];

impl Character {
    /// Makes the chain, writes it to `folder`, measures and draws.
    pub(super) fn run(session: &Session, folder: &Path) -> Result<Self, Failure> {
        let original = sample(Sample::Character, TRIANGLES);
        let total = original.drawn_triangle_count();
        let chain = |poses: PoseSet, refit: bool, geomorph: GeomorphForm| -> Result<LodChain, Failure> {
            let levels = PERCENTS.iter().map(|percent| LevelTarget::Triangles(total * percent / 100)).collect();
            let options = LodOptions { levels, poses, refit, geomorph, ..LodOptions::default() };
            lod_chain(&original, &options, session.quiet_control()).map_err(|error| failed(session, error))
        };
        let clips = PoseSet::Clips { most: POSES };
        let plain = GeomorphForm::default();
        let morphing = GeomorphForm { target: true, ..plain };
        let ways =
            [chain(PoseSet::Bind, false, plain)?, chain(clips.clone(), false, plain)?, chain(clips, true, morphing)?];
        let levels: Vec<Asset> = ways.iter().map(|way| original.at_level(&way.levels[MEASURED])).collect();
        let clips = (0..original.clips().len()).map(|clip| Clip::measure(session, &original, &levels, clip));
        let clips = clips.collect::<Result<Vec<Clip>, Failure>>()?;
        let best = &ways[WAYS.len() - 1];
        let path = folder.join("character-levels.glb");
        session.write(&original.with_levels(best), &path, &WriteOptions::default())?;
        Ok(Self {
            triangles: total,
            levels: best.levels.iter().map(|level| level.triangles).collect(),
            clips,
            film: film_of(&original, best),
        })
    }

    /// Root mean square distance over all frames, as a share of the diagonal, and the worst frame's.
    fn figures(&self, way: usize) -> (f64, f64) {
        let frames: Vec<f64> = self.clips.iter().flat_map(|clip| &clip.frames[way]).map(|frame| frame.1).collect();
        let mean = frames.iter().map(|rms| rms * rms).sum::<f64>() / frames.len() as f64;
        (mean.sqrt(), frames.iter().copied().fold(0.0, f64::max))
    }

    pub(super) fn json(&self) -> Value {
        let ways = WAYS.iter().enumerate().map(|(way, (name, _))| {
            let (rms, worst) = self.figures(way);
            json!({ "name": name, "rms_of_diagonal": rms, "worst_frame_of_diagonal": worst })
        });
        json!({ "triangles": self.triangles, "levels": self.levels, "ways": ways.collect::<Vec<_>>() })
    }

    pub(super) fn html(&self) -> String {
        let levels: Vec<String> = self.levels.iter().map(|&triangles| count(triangles)).collect();
        let (alone, fitted) = (self.figures(0).0, self.figures(WAYS.len() - 1).0);
        let lead = format!(
            "<p>A character of {} triangles with a skeleton and {} clips; its levels have {}. All move with the same clips. Over \
             these, the level of {} triangles is off by {} of the diagonal (root mean square) if it is simplified in one \
             pose, and by {} if all that the clips do counts.</p>\n",
            count(self.triangles),
            self.clips.len(),
            levels.join(", "),
            levels[MEASURED],
            percent(alone),
            percent(fitted)
        );
        let row = |(way, (name, what)): (usize, &(&str, &str))| {
            let (rms, worst) = self.figures(way);
            vec![(*name).to_owned(), (*what).to_owned(), percent(rms), percent(worst), format!("{:.2}", rms / alone)]
        };
        let rows: Vec<Vec<String>> = WAYS.iter().enumerate().map(row).collect();
        let caption = format!(
            "Distances at {} triangles, in percent of the diagonal of the posed original, the larger of both directions; {FRAMES} \
             frames of each clip, {} points on each surface in each.",
            levels[MEASURED],
            count(SAMPLES)
        );
        let figures = table(&caption, &["Way", "", "RMS", "Worst frame", "Relative"], &rows);
        let frames = self.clips.iter().flat_map(|clip| clip.frames.iter().flatten());
        let most = frames.map(|frame| 100.0 * frame.1).fold(0.0, f64::max);
        let plots: String = self.clips.iter().map(|clip| clip.plot(most)).collect();
        let film = film(&self.film, (PICTURE.0 / 2, PICTURE.1 / 2));
        format!(
            "{lead}{figures}<div class=\"columns\">\n{plots}</div>\n<p>How {} triangles melt into {}, while it moves: the last \
             picture is the coarser level.</p>\n{film}",
            levels[levels.len() - 2],
            levels[levels.len() - 1]
        )
    }
}

impl Clip {
    fn measure(session: &Session, original: &Asset, levels: &[Asset], number: usize) -> Result<Self, Failure> {
        let clip = &original.clips()[number];
        let animation = original.animation(number);
        let options = CompareOptions { samples: SAMPLES, ..CompareOptions::default() };
        let mut frames = vec![Vec::new(); levels.len()];
        for k in 0..FRAMES {
            let seconds = clip.start() + (clip.end() - clip.start()) * (k as f64 + 0.5) / FRAMES as f64;
            let instances = animation.instances_at(seconds);
            let posed = original.merged_positions_of(&instances);
            for (level, frames) in levels.iter().zip(&mut frames) {
                let level = level.merged_positions_of(&instances);
                let compared = compare(&posed, &level, &options, session.quiet_control());
                let compared = compared.map_err(|error| failed(session, error))?;
                frames.push((seconds, compared.relative(compared.rms())));
            }
        }
        Ok(Self { name: clip.name.clone(), frames })
    }

    fn plot(&self, most: f64) -> String {
        let series = |((name, _), frames): (&(&str, &str), &Vec<(f64, f64)>)| Series {
            name: (*name).to_owned(),
            points: frames.iter().map(|&(seconds, rms)| (seconds, 100.0 * rms)).collect(),
        };
        let series: Vec<Series> = WAYS.iter().zip(&self.frames).map(series).collect();
        let name = escape(&self.name);
        let what = format!("RMS distance over the clip {name}, one line to each way");
        let svg = linear(&series, most, &format!("seconds of '{name}'"), "RMS, % of the diagonal", &what);
        format!("<div class=\"scroll\" tabindex=\"0\">{svg}</div>\n")
    }
}

/// The way to the last level in one moment of the first clip, as any viewer of glTF shows it.
fn film_of(original: &Asset, chain: &LodChain) -> Vec<Picture> {
    let [finer, _] = &chain.levels[chain.levels.len() - 2..] else { return Vec::new() };
    let asset = original.at_level(finer);
    let clip = &original.clips()[0];
    let instances = original.animation(0).instances_at(clip.start() + 0.3 * (clip.end() - clip.start()));
    let frozen =
        |instances: &[Instance], asset: &Asset| Asset::from_mesh("character", asset.merged_positions_of(instances));
    let whole = frozen(&instances, original);
    let studio = Studio::new(&whole, false, &[VIEW], PICTURE);
    let picture = |k: usize| {
        let t = k as f32 / (PICTURES - 1) as f32;
        let mut morphed = instances.clone();
        for instance in &mut morphed {
            let targets = asset.meshes[instance.mesh].mesh.morph_targets.len();
            instance.morph_weights.resize(targets, 0.0);
            instance.morph_weights.last_mut().into_iter().for_each(|weight| *weight = t);
        }
        let png = studio.picture(&studio.model(&frozen(&morphed, &asset)), 0, Look::Wireframe);
        Picture {
            caption: format!("{:.0} %", 100.0 * t),
            alt: format!("The character, {:.0} % morphed", 100.0 * t),
            png,
        }
    };
    (0..PICTURES).map(picture).collect()
}
