//! The report of `maille compare --animated`.

use super::animated::{Distances, Frame, Measured, MeasuredClip};
use crate::args::CompareArgs;
use crate::commands::report::{Page, Series, bar, command_line, count, escape, facts, linear, percent, table};
use crate::output::number;

/// Clips in a plot: as many as there are colours, less one for the rest pose.
const CLIPS_IN_A_PLOT: usize = 7;
/// Most letters of a clip's name in a plot.
const LONGEST_NAME: usize = 24;

/// A frame in words.
pub(super) fn moment(clip: &MeasuredClip, frame: &Frame) -> String {
    format!("{} at {} s", clip.name, number(frame.seconds))
}

pub(super) fn page(args: &CompareArgs, measured: &Measured) -> String {
    let name = |path: &std::path::Path| path.file_name().unwrap_or_default().to_string_lossy().into_owned();
    let heading = format!("{} in motion", name(&args.b));
    let frames = measured.frames().count();
    let lead = format!(
        "Its distance from {}, posed alike, in {} frames of {} clips and at rest.",
        escape(&name(&args.a)),
        count(frames),
        count(measured.clips.len())
    );
    let mut page = Page::new(&heading, &heading, &lead);
    page.add(&headlines(measured));
    page.section("Error over time", &plots(measured));
    page.section("Clips", &clips(args, measured));
    page.section("How it was made", &format!("<pre><code>{}</code></pre>\n", escape(&command_line())));
    page.finish("The same figures, with every frame, are beside this page as JSON.")
}

/// The figures that tell the most.
fn headlines(measured: &Measured) -> String {
    let fact = |distance: f64, share: f64, place: &str| {
        let of =
            if share.is_nan() { String::new() } else { format!("<small>{} of the diagonal</small>", percent(share)) };
        let place = if place.is_empty() { String::new() } else { format!("<small>{}</small>", escape(place)) };
        format!("{}{of}{place}", number(distance))
    };
    let (all, rest) = (measured.all(), &measured.rest);
    let (worst_clip, worst) = measured.worst(|distances| distances.rms);
    let (far_clip, far) = measured.worst(|distances| distances.max);
    facts(&[
        ("RMS over all frames", fact(all.rms, all.shares[1], "")),
        ("RMS at rest", fact(rest.rms, rest.shares[1], "")),
        ("RMS of the worst frame", fact(worst.distances.rms, worst.distances.shares[1], &moment(worst_clip, worst))),
        ("Largest distance", fact(far.distances.max, far.distances.shares[2], &moment(far_clip, far))),
    ])
}

/// The root mean square distance over the time of each clip. Of more clips than a plot can hold, the worst are in the first
/// one, and the others are folded.
fn plots(measured: &Measured) -> String {
    let rest = measured.rest.rms;
    let most = measured.worst(|distances| distances.rms).1.distances.rms.max(rest);
    let plot = |clips: &[&MeasuredClip]| {
        let times = clips.iter().flat_map(|clip| [clip.start, clip.end]);
        let (first, last) = times.fold((f64::INFINITY, f64::NEG_INFINITY), |(a, b), t| (a.min(t), b.max(t)));
        let mut series: Vec<Series> = clips.iter().map(|clip| line(clip)).collect();
        series.push(Series { name: "at rest".to_owned(), points: vec![(first, rest), (last, rest)] });
        let what = "RMS distance over time, one line to each clip, and that at rest";
        let svg = linear(&series, most, "seconds", "RMS distance, units of the file", what);
        format!("<div class=\"scroll\" tabindex=\"0\">{svg}</div>\n")
    };
    let mut clips: Vec<&MeasuredClip> = measured.clips.iter().collect();
    if clips.len() <= CLIPS_IN_A_PLOT {
        return plot(&clips);
    }
    clips.sort_by(|a, b| b.distances().rms.total_cmp(&a.distances().rms));
    let (worst, others) = clips.split_at(CLIPS_IN_A_PLOT);
    let summary = format!("The other {} clips, the worst first", count(others.len()));
    let others: String = others.chunks(CLIPS_IN_A_PLOT).map(plot).collect();
    format!(
        "{}<details><summary>{summary}</summary>\n<div class=\"columns\">\n{others}</div>\n</details>\n",
        plot(worst)
    )
}

fn line(clip: &MeasuredClip) -> Series {
    let points = clip.frames.iter().map(|frame| (frame.seconds, frame.distances.rms)).collect();
    Series { name: short(&clip.name), points }
}

/// The beginning of a name, as HTML.
fn short(name: &str) -> String {
    match name.char_indices().nth(LONGEST_NAME) {
        Some((end, _)) => format!("{}…", escape(&name[..end])),
        None => escape(name),
    }
}

fn clips(args: &CompareArgs, measured: &Measured) -> String {
    let clips = measured.clips.iter().map(|clip| (clip, clip.distances()));
    let most = clips.clone().map(|(_, distances)| distances.rms).fold(f64::MIN_POSITIVE, f64::max);
    let cells = |name: String, time: String, frames: usize, distances: &Distances| {
        let mut cells = vec![name, time, count(frames)];
        let figures = [distances.mean, distances.rms, distances.max].into_iter().zip(distances.shares);
        cells.extend(figures.flat_map(|(distance, share)| {
            [number(distance), if share.is_nan() { String::new() } else { percent(share) }]
        }));
        cells[5] = bar(&cells[5], distances.rms / most);
        cells
    };
    let mut rows: Vec<Vec<String>> =
        clips.map(|(clip, distances)| cells(escape(&clip.name), clip.time(), clip.frames.len(), &distances)).collect();
    rows.push(cells("all frames".to_owned(), String::new(), measured.frames().count(), &measured.all()));
    rows.push(cells("at rest".to_owned(), String::new(), 1, &measured.rest));
    let caption = format!(
        "Distances in units of the file and in percent of the diagonal of the posed original, the larger of both directions; \
         {} points on each surface in each frame, seed {}.",
        count(measured.samples),
        args.seed
    );
    let head = ["clip", "seconds", "frames", "mean", "of diagonal", "RMS", "of diagonal", "largest", "of diagonal"];
    table(&caption, &head, &rows)
}
