//! Figures as JSON and as rows of tables, the same in every command that tells them.

use maille::measure::{AttributeDeviation, Comparison, Deviation, Figures};
use maille::{Mesh, Semantic};
use serde_json::{Map, Value, json};

use super::trial::Trial;
use crate::output;

/// What `maille compare --json` tells of the two surfaces.
pub(crate) fn comparison_json(c: &Comparison) -> Map<String, Value> {
    let object = json!({
        "mean": c.mean(),
        "rms": c.rms(),
        "max": c.max(),
        "diagonal": c.diagonal,
        "normal_deg": c.normal_deg(),
        "forward": deviation_json(&c.forward),
        "backward": deviation_json(&c.backward),
        "figures_a": figures_json(&c.a),
        "figures_b": figures_json(&c.b),
    });
    match object {
        Value::Object(map) => map,
        _ => unreachable!("it is written as an object"),
    }
}

fn deviation_json(d: &Deviation) -> Value {
    json!({
        "mean": d.mean,
        "rms": d.rms,
        "max": d.max,
        "max_from": d.max_from,
        "max_to": d.max_to,
        "normal_deg": d.normal.mean_deg,
        "normal_rms_deg": d.normal.rms_deg,
        "normal_max_deg": d.normal.max_deg,
        "flipped_share": d.normal.flipped_share,
        "samples": d.samples,
        "extra_points": d.extra_points,
    })
}

fn figures_json(f: &Figures) -> Value {
    json!({
        "vertices": f.vertices,
        "triangles": f.triangles,
        "area": f.area,
        "volume": f.volume,
        "components": f.components,
        "euler_characteristic": f.euler_characteristic,
        "boundary_edges": f.boundary_edges,
        "boundary_length": f.boundary_length,
        "non_manifold_edges": f.non_manifold_edges,
        "min_angle_deg": f.quality.min_angle_deg,
        "mean_angle_deg": f.quality.mean_angle_deg,
        "mean_shape": f.quality.mean_shape,
        "mean_aspect": f.quality.mean_aspect,
        "bad_share": f.quality.bad_share,
        "degenerate": f.quality.degenerate,
    })
}

/// A point of a curve of errors over triangles.
pub(crate) fn curve_json(trial: &Trial) -> Value {
    json!({
        "triangles": trial.report.triangles_out,
        "seconds": trial.seconds,
        "mean": trial.comparison.mean(),
        "rms": trial.comparison.rms(),
        "max": trial.comparison.max(),
    })
}

/// How far attributes are apart.
pub(crate) fn attributes_json(attributes: &[AttributeDeviation]) -> Vec<Value> {
    let one = |a: &AttributeDeviation| json!({ "attribute": a.semantic.to_string(), "unit": unit(&a.semantic), "mean": a.mean, "rms": a.rms, "max": a.max });
    attributes.iter().map(one).collect()
}

/// The same as rows of a table: attribute, mean, root mean square, largest.
pub(crate) fn attributes_rows(attributes: &[AttributeDeviation]) -> Vec<Vec<String>> {
    let row = |a: &AttributeDeviation| {
        let mut cells = vec![super::escape(&attribute_name(&a.semantic))];
        cells.extend([a.mean, a.rms, a.max].map(output::number));
        cells
    };
    attributes.iter().map(row).collect()
}

/// An attribute with the unit of its differences.
fn attribute_name(semantic: &Semantic) -> String {
    match unit(semantic) {
        "" => semantic.to_string(),
        unit => format!("{semantic} ({unit})"),
    }
}

fn unit(semantic: &Semantic) -> &'static str {
    match semantic {
        Semantic::Normal | Semantic::Tangent => "degrees",
        Semantic::Color(_) => "of 1",
        Semantic::TexCoord(_) => "of the texture's side",
        _ => "",
    }
}

/// Width of a bin of [`angle_bins`], in degrees.
const BIN_DEG: usize = 5;

/// Shares of the triangles by their smallest angle, in bins of 5 degrees from 0 to 60.
pub(crate) fn angle_bins(mesh: &Mesh) -> Vec<f64> {
    let mut bins = [0_u64; 60 / BIN_DEG];
    let last = bins.len() - 1;
    for angle in maille::measure::smallest_angles_deg(mesh) {
        bins[(angle as usize / BIN_DEG).min(last)] += 1;
    }
    let total = mesh.triangle_count().max(1) as f64;
    bins.iter().map(|&count| count as f64 / total).collect()
}
