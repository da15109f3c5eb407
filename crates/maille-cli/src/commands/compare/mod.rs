//! `maille compare`

mod animated;
mod page;

use std::path::Path;

use maille::Mesh;
use maille::measure::{
    CompareError, CompareOptions, Comparison, Deviation, ExactComparison, ExactOptions, Figures, Side, compare,
    distances_at_vertices, hausdorff, heatmap,
};
use maille_io::{Asset, Format, WriteOptions, Written};
use serde_json::{Map, Value};

use super::report::comparison_json;
use crate::args::{CompareArgs, Distance};
use crate::failure::Failure;
use crate::output::{self, Listing};
use crate::session::Session;

/// Points sampled on each surface, where the user does not say.
const SAMPLES: u64 = 1_000_000;

pub(crate) fn run(args: &CompareArgs) -> Result<(), Failure> {
    if args.animated {
        return animated::run(args);
    }
    if let Some(path) = &args.heatmap {
        check_heatmap(args, path)?;
    }
    let session = Session::start(&args.common)?;
    let (a, b) = (session.read(&args.a)?, session.read(&args.b)?);
    let (a, b) = (a.flattened(), b.flattened());
    let options = sampling(args, SAMPLES);
    let mut comparison = compare(&a, &b, &options, session.control()).map_err(|error| refusal(args, &error))?;
    session.checkpoint()?;
    let exact = match args.exact {
        true => Some(prove(args, &session, &a, &b, &mut comparison)?),
        false => None,
    };
    let exact = exact.as_ref();
    let drawn = match &args.heatmap {
        Some(path) => Some(write_heatmap(&session, args, &a, &b, path)?),
        None => None,
    };
    let drawn = drawn.as_ref();
    session.result(|| json(args, &session, &comparison, exact, drawn), || text(args, &comparison, exact, drawn))
}

fn sampling(args: &CompareArgs, samples: u64) -> CompareOptions {
    CompareOptions { samples: args.samples.unwrap_or(samples), seed: args.seed, edges: args.edges }
}

/// Puts proven maxima in the place of the sampled ones.
fn prove(
    args: &CompareArgs,
    session: &Session,
    a: &Mesh,
    b: &Mesh,
    comparison: &mut Comparison,
) -> Result<ExactComparison, Failure> {
    let mut options = ExactOptions::default();
    match args.tolerance {
        Some(Distance::OfDiagonal(share)) => options.tolerance = share,
        Some(Distance::Units(units)) if comparison.diagonal > 0.0 => options.tolerance = units / comparison.diagonal,
        _ => {}
    }
    let proven = hausdorff(a, b, &options, session.control()).map_err(|error| refusal(args, &error))?;
    session.checkpoint()?;
    for (side, proven) in [(&mut comparison.forward, &proven.forward), (&mut comparison.backward, &proven.backward)] {
        (side.max, side.max_from, side.max_to) = (proven.upper, proven.from, proven.to);
    }
    Ok(proven)
}

/// Refuses a heat map that would have no colours, or that would replace what is compared.
fn check_heatmap(args: &CompareArgs, path: &Path) -> Result<(), Failure> {
    super::check_output(path)?;
    let problem = if Format::from_path(path) == Some(Format::Stl) {
        "an STL has no colours at its vertices; write the heat map as .ply, .glb, .gltf, .obj or .off"
    } else if [&args.a, &args.b].into_iter().any(|input| super::is_same_file(input, path)) {
        "this is one of the files to compare; choose another name for the heat map"
    } else {
        return Ok(());
    };
    Err(Failure::Usage(format!("{}: {problem}", path.display())))
}

/// A heat map that has been written.
struct Drawn {
    /// The distance that has the last colour.
    most: f64,
    written: Written,
}

/// Writes A coloured by its distance to B.
fn write_heatmap(session: &Session, args: &CompareArgs, a: &Mesh, b: &Mesh, path: &Path) -> Result<Drawn, Failure> {
    let distances = distances_at_vertices(a, b, session.control()).map_err(|error| refusal(args, &error))?;
    session.checkpoint()?;
    let found = distances.iter().copied().filter(|distance| distance.is_finite()).fold(0.0, f32::max);
    let most = args.heatmap_max.map_or(found, |most| most.in_units(a.diagonal()) as f32);
    let coloured = Asset::from_mesh("distance", heatmap(a, &distances, [0.0, most]));
    let written = session.write(&coloured, path, &WriteOptions::default())?;
    Ok(Drawn { most: f64::from(most), written })
}

fn refusal(args: &CompareArgs, error: &CompareError) -> Failure {
    let side = match error {
        CompareError::Cancelled(_) => return Failure::Cancelled,
        CompareError::Empty { side } | CompareError::NotFinite { side, .. } | CompareError::Mesh { side, .. } => *side,
        _ => Side::A,
    };
    let path = match side {
        Side::A => &args.a,
        Side::B => &args.b,
    };
    let remedy = match error {
        CompareError::NotFinite { .. } => format!(" (maille repair {} -o OUT)", path.display()),
        CompareError::Empty { .. } => format!(" (maille info {} tells what it draws)", path.display()),
        _ => String::new(),
    };
    Failure::about(path, format!("{error}{remedy}"))
}

fn json(
    args: &CompareArgs,
    session: &Session,
    c: &Comparison,
    exact: Option<&ExactComparison>,
    drawn: Option<&Drawn>,
) -> Value {
    let mut object = Map::new();
    object.insert("a".to_owned(), args.a.display().to_string().into());
    object.insert("b".to_owned(), args.b.display().to_string().into());
    object.extend(comparison_json(c));
    object.insert("samples".to_owned(), args.samples.unwrap_or(SAMPLES).into());
    object.insert("seed".to_owned(), args.seed.into());
    object.insert("threads".to_owned(), session.threads().into());
    object.insert("heatmap".to_owned(), args.heatmap.as_ref().map(|path| path.display().to_string()).into());
    object.insert("heatmap_max".to_owned(), drawn.map(|drawn| drawn.most).into());
    object.insert("files".to_owned(), drawn.map_or(Vec::new(), |drawn| output::paths(&drawn.written.files)).into());
    object.insert("exact".to_owned(), exact.is_some().into());
    if let Some(exact) = exact {
        object.insert("max_lower".to_owned(), exact.lower().into());
        object.insert("max_upper".to_owned(), exact.upper().into());
        object.insert("tolerance".to_owned(), exact.tolerance.into());
        object.insert("converged".to_owned(), exact.converged().into());
        for (way, proven) in [("forward", &exact.forward), ("backward", &exact.backward)] {
            object[way]["max_lower"] = proven.lower.into();
            object[way]["max_upper"] = proven.upper.into();
            object[way]["searches"] = proven.searches.into();
            object[way]["converged"] = proven.converged.into();
        }
    }
    Value::Object(object)
}

fn text(args: &CompareArgs, c: &Comparison, exact: Option<&ExactComparison>, drawn: Option<&Drawn>) -> String {
    let mut text = format!("A  {}\nB  {}\n\n", args.a.display(), args.b.display());
    text += &output::table(&distance_rows(c, exact.is_some()));
    text.push('\n');
    text += &output::table(&figure_rows(&c.a, &c.b));
    let mut listing = Listing::default();
    listing.heading("");
    listing.line("diagonal of A", output::number(c.diagonal));
    let points = output::count(c.forward.samples);
    listing.line("sampling", format!("{points} points on each surface and all vertices, seed {}", args.seed));
    if let Some(exact) = exact {
        let width = output::distance(exact.upper() - exact.lower(), c.diagonal);
        let short = if exact.converged() { "" } else { ", wider than asked for: too many pieces were left" };
        listing.line("proof", format!("the maximum is at most what is told, and at least that less {width}{short}"));
    }
    if let Some(Drawn { most, written }) = drawn {
        listing.line("heat map", format!("{}, yellow from {}", output::written(&written.files), output::number(*most)));
    }
    text + &listing.text()
}

fn distance_rows(c: &Comparison, proven: bool) -> Vec<Vec<String>> {
    let row = |name: &str, symmetric: f64, pick: fn(&Deviation) -> f64| {
        let percent = match c.diagonal > 0.0 {
            true => format!("{}%", output::number(100.0 * c.relative(symmetric))),
            false => String::new(),
        };
        let both = [pick(&c.forward), pick(&c.backward)].map(output::number);
        let [forward, backward] = both;
        vec![name.to_owned(), output::number(symmetric), percent, forward, backward]
    };
    let header = ["distance", "symmetric", "of diagonal", "A to B", "B to A"].map(str::to_owned).to_vec();
    let degrees = |x: f64| format!("{} deg", output::number(x));
    vec![
        header,
        row("mean", c.mean(), |d| d.mean),
        row("RMS", c.rms(), |d| d.rms),
        row(if proven { "maximum, proven" } else { "maximum" }, c.max(), |d| d.max),
        vec![
            "normals, mean".to_owned(),
            degrees(c.normal_deg()),
            String::new(),
            degrees(c.forward.normal.mean_deg),
            degrees(c.backward.normal.mean_deg),
        ],
    ]
}

fn figure_rows(a: &Figures, b: &Figures) -> Vec<Vec<String>> {
    let change = |a: f64, b: f64| match a != 0.0 && (a - b) != 0.0 {
        true => format!("{:+.3}%", 100.0 * (b - a) / a.abs()),
        false => String::new(),
    };
    let real = |name: &str, pick: fn(&Figures) -> f64| {
        let (a, b) = (pick(a), pick(b));
        vec![name.to_owned(), output::number(a), output::number(b), change(a, b)]
    };
    let whole = |name: &str, pick: fn(&Figures) -> i64| {
        let (a, b) = (pick(a), pick(b));
        vec![name.to_owned(), a.to_string(), b.to_string(), change(a as f64, b as f64)]
    };
    vec![
        ["surface", "A", "B", "change"].map(str::to_owned).to_vec(),
        whole("triangles", |f| f.triangles.into()),
        whole("vertices", |f| f.vertices.into()),
        real("area", |f| f.area),
        real("volume", |f| f.volume),
        whole("components", |f| f.components.into()),
        whole("Euler characteristic", |f| f.euler_characteristic),
        real("boundary length", |f| f.boundary_length),
        whole("non-manifold edges", |f| f.non_manifold_edges.into()),
        real("smallest angle, mean (deg)", |f| f.quality.mean_angle_deg),
        real("smallest angle, least (deg)", |f| f.quality.min_angle_deg),
        real("aspect, mean", |f| f.quality.mean_aspect),
        whole("triangles without area", |f| f.quality.degenerate.into()),
    ]
}
