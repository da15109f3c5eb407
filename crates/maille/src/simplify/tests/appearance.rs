//! Attributes in the metric.

use glam::{DVec2, DVec3, Vec2, Vec3};

use super::super::attributes::AttributeMetric;
use super::super::metric::{Anchor, EdgeContext, Metric};
use super::super::quadric_options;
use super::*;
use crate::mesh::Values;
use crate::topology::collapse_mesh::Frame;

/// A dented torus with a colour and a normal to each vertex that have nothing to do with its shape.
fn painted() -> Mesh {
    let mut mesh = dented_torus();
    let n = mesh.vertex_count() as u32;
    let colors = (0..3 * n).map(|i| noise(i + 7)).collect();
    let normals =
        (0..n).flat_map(|v| Vec3::from([0, 1, 2].map(|k| noise(3 * v + k + 5000) - 0.5)).normalize().to_array());
    mesh.wedge_attributes.push(Attribute::new_f32(Semantic::Color(0), 3, colors));
    mesh.wedge_attributes.push(Attribute::new_f32(Semantic::Normal, 3, normals.collect()));
    mesh
}

/// A sphere with a checkerboard of two colours.
fn checkered() -> Mesh {
    let mut mesh = shapes::sphere(5);
    let dark = |p: &[f32; 3]| p.iter().filter(|x| (**x * 3.0).floor() as i32 % 2 != 0).count() % 2 == 0;
    let colors = mesh.positions.iter().flat_map(|p| if dark(p) { [0.1, 0.2, 0.3] } else { [0.9, 0.8, 0.4] }).collect();
    mesh.wedge_attributes.push(Attribute::new_f32(Semantic::Color(0), 3, colors));
    mesh
}

/// Mean difference of the colours of one mesh from those of another, looked up at the nearest points.
fn color_difference(from: &Mesh, to: &Mesh) -> f64 {
    let colors = |mesh: &Mesh, w: u32| Vec3::from_slice(value(&mesh.wedge_attributes[0], w as usize));
    let tree = crate::measure::Bvh::new(to);
    let mut sum = 0.0;
    for (w, &v) in from.wedge_vertices.iter().enumerate() {
        let near = tree.closest(Vec3::from(from.positions[v as usize]).as_dvec3()).expect("not empty");
        let corners = to.triangles[near.triangle as usize];
        let found: Vec3 = (0..3).map(|k| colors(to, corners[k]) * near.barycentric[k] as f32).sum();
        sum += f64::from((found - colors(from, w as u32)).length());
    }
    sum / from.wedge_count() as f64
}

#[test]
fn the_quadric_is_what_the_faces_say() {
    let mesh = painted();
    let mut options = to(100);
    options.attributes.named.push((Semantic::Normal, 0.3));
    let frame = Frame::of(&mesh.positions);
    let faces = order::faces_of(&mesh);
    let surface = quadric_options(&options, || 1.0).unwrap();
    let mut metric =
        AttributeMetric::new(QuadricMetric::new(surface), &mesh, &frame, &options).expect("two attributes count");
    metric.prepare(&faces, &Features::default());
    let told = metric.carried.errors();
    for edge in (0..faces.edge_count() as u32).step_by(97) {
        let ends = faces.ends(edge);
        let context = EdgeContext { ends, points: ends.map(|v| faces.point(v)), anchor: Anchor::Free };
        let q = metric.quadric(&faces, &context);
        for place in 0..3 {
            let p = (context.points[0] + context.points[1]) / 2.0
                + DVec3::from([0, 1, 2].map(|k| 0.02 * f64::from(noise(edge + 10 * place + k) - 0.5)));
            let mut expected = 0.0;
            for (attribute, told) in mesh.wedge_attributes.iter().zip(&told) {
                let weight = told.weight / frame.unit();
                for k in 0..3 {
                    // (area, prediction) of each face around either end, by the gradient that hits its three corners
                    let mut predictions = Vec::new();
                    for v in ends {
                        for face in faces.faces_around(v) {
                            let [o, x, y] = [v, face.x, face.y].map(|v| faces.point(v));
                            let [s, sx, sy] = [v, face.x, face.y].map(|v| f64::from(value(attribute, v as usize)[k]));
                            let (ex, ey) = (x - o, y - o);
                            let n = ex.cross(ey);
                            let gradient = glam::DMat3::from_cols(ex, ey, n).transpose().inverse()
                                * DVec3::new(sx - s, sy - s, 0.0);
                            // the damping of needles
                            let sine_sq = n.length_squared() / (ex.length_squared() * ey.length_squared());
                            let gradient = gradient * (sine_sq / 1e-3).min(1.0);
                            predictions.push((n.length() / 2.0, s + gradient.dot(p - o)));
                        }
                    }
                    let area: f64 = predictions.iter().map(|(area, _)| area).sum();
                    let mean = predictions.iter().map(|(area, s)| area * s).sum::<f64>() / area;
                    expected +=
                        predictions.iter().map(|(area, s)| area * (s - mean).powi(2)).sum::<f64>() * weight * weight;
                }
            }
            assert!((q.at(p) - expected).abs() < 1e-5 * expected, "{} for {expected}", q.at(p));
        }
    }
}

#[test]
fn edges_of_colour_stay_where_they_are() {
    let mesh = checkered();
    let (with, report) = reduced(&mesh, &to(1600));
    let (without, plain) = reduced(&mesh, &SimplifyOptions { attributes: AttributeWeights::NONE, ..to(1600) });
    let [with, without] = [with, without].map(|small| color_difference(&mesh, &small));
    assert!(with < 0.5 * without, "{with} for {without}");
    assert!(report.attributes[0].error > 0.0 && plain.attributes.is_empty());
}

#[test]
fn generalized_quadrics_see_colours_too() {
    let mesh = checkered();
    let kind = AttributeMetricKind::GeneralizedQuadric;
    let (with, report) = reduced(&mesh, &SimplifyOptions { attribute_metric: kind, ..to(1600) });
    let (without, _) = reduced(&mesh, &SimplifyOptions { attributes: AttributeWeights::NONE, ..to(1600) });
    let [with, without] = [with, without].map(|small| color_difference(&mesh, &small));
    assert!(with < 0.7 * without, "{with} for {without}");
    assert!(report.attributes[0].error > 0.0 && report.stopped == Stop::Triangles);
}

#[test]
fn attributes_of_vertices_count_like_those_of_wedges() {
    let mesh = checkered();
    let mut at_vertices = mesh.clone();
    assert!(mesh.wedge_vertices.iter().zip(0..).all(|(&v, w)| v == w));
    at_vertices.vertex_attributes.append(&mut at_vertices.wedge_attributes);
    let plain = Attribute::new_u32(Semantic::Custom("number".into()), 1, (0..mesh.vertex_count() as u32).collect());
    at_vertices.vertex_attributes.insert(0, plain);
    let (of_wedges, _) = reduced(&mesh, &to(1600));
    let (of_vertices, report) = reduced(&at_vertices, &to(1600));
    assert!(of_vertices.positions == of_wedges.positions && of_vertices.wedge_attributes.is_empty());
    assert!(of_vertices.vertex_attributes[1] == of_wedges.wedge_attributes[0]);
    assert_eq!(report.attributes.len(), 1);
    of_vertices.check().unwrap();
}

#[test]
fn what_looks_different_in_the_dark_counts_in_lab() {
    let mut mesh = checkered();
    let colors = mesh.wedge_attributes[0].as_f32_mut().unwrap();
    colors.iter_mut().for_each(|x| *x = if *x > 0.35 { 0.04 } else { 0.005 });
    let with = |color_space| reduced(&mesh, &SimplifyOptions { color_space, ..to(1600) }).0;
    let [rgb, lab] = [ColorSpace::Rgb, ColorSpace::Lab].map(|space| color_difference(&mesh, &with(space)));
    assert!(lab < 0.8 * rgb, "{lab} for {rgb}");
    // what is not touched keeps its bits, what is mixed comes back into the same space
    let small = with(ColorSpace::Lab);
    let values = small.wedge_attributes[0].as_f32().unwrap();
    assert!(values.iter().all(|x| (0.004..0.041).contains(x)));
    assert!(values.iter().any(|x| [0.005, 0.04].contains(x)));
}

#[test]
fn a_flat_picture_is_reduced_where_it_is_plain() {
    let mut mesh = shapes::grid(40);
    let bright = |p: &[f32; 3]| if (p[0] - 0.5).hypot(p[1] - 0.5) < 0.3 { 1.0 } else { 0.0 };
    let colors = mesh.positions.iter().flat_map(|p| [bright(p); 3]).collect();
    mesh.wedge_attributes.push(Attribute::new_f32(Semantic::Color(0), 3, colors));
    let (small, _) = reduced(&mesh, &to(600));
    assert!(color_difference(&mesh, &small) < 0.02, "{}", color_difference(&mesh, &small));
}

/// A grid with a seam in the middle of its texture, one half mirrored, and bent normals without a seam.
fn mirrored() -> Mesh {
    let mut mesh = terrain(24);
    mesh.compute_normals(&Default::default());
    let middle = {
        let (low, high) = mesh.bounds().unwrap();
        (low[0] + high[0]) / 2.0
    };
    let wedges = mesh.wedge_count() as u32;
    let mut twin = BTreeMap::new();
    for t in 0..mesh.triangle_count() {
        let mean: f64 = mesh.triangle_points(t).iter().map(|p| p.x).sum::<f64>() / 3.0;
        if mean > f64::from(middle) {
            for k in 0..3 {
                let w = mesh.triangles[t][k];
                let next = wedges + twin.len() as u32;
                mesh.triangles[t][k] = *twin.entry(w).or_insert(next);
            }
        }
    }
    let mut source: Vec<u32> = (0..wedges).collect();
    let mut twins: Vec<(u32, u32)> = twin.into_iter().map(|(w, twin)| (twin, w)).collect();
    twins.sort_unstable();
    source.extend(twins.iter().map(|&(_, w)| w));
    mesh.wedge_vertices = source.iter().map(|&w| mesh.wedge_vertices[w as usize]).collect();
    mesh.wedge_attributes.iter_mut().for_each(|a| a.gather(&source));
    let place = |w: usize| {
        let [x, y, _] = mesh.positions[mesh.wedge_vertices[w] as usize];
        if w < wedges as usize { [x, y] } else { [2.0 * middle + 0.25 - x, y] }
    };
    let uv = (0..source.len()).flat_map(place).collect();
    mesh.wedge_attributes.push(Attribute::new_f32(Semantic::TexCoord(0), 2, uv));
    Mesh::check(&mesh).unwrap();
    mesh
}

#[test]
fn a_seam_of_the_texture_is_no_crease_and_nothing_folds() {
    let mesh = mirrored();
    let (small, _) = reduced(&mesh, &to(200));
    let normals = small.wedge_attribute(&Semantic::Normal).unwrap();
    let uv = texcoords(&small);
    let mut at_vertex = BTreeMap::new();
    let mut seam_vertices = 0;
    for (w, &v) in small.wedge_vertices.iter().enumerate() {
        if let Some(other) = at_vertex.insert(v, w) {
            seam_vertices += 1;
            assert_eq!(value(normals, w), value(normals, other), "vertex {v}");
            assert_ne!(value(uv, w), value(uv, other));
        }
    }
    assert!(seam_vertices > 3, "{seam_vertices}");
    let folded = |triangle: &[u32; 3], mirrored: bool| {
        let [a, b, c]: [DVec2; 3] = triangle.map(|w| Vec2::from_slice(value(uv, w as usize)).as_dvec2());
        (b - a).perp_dot(c - a) * if mirrored { -1.0 } else { 1.0 } < 0.0
    };
    let middle = f64::from(mesh.bounds().unwrap().0[0] + mesh.bounds().unwrap().1[0]) / 2.0;
    for (t, triangle) in small.triangles.iter().enumerate() {
        let mean: f64 = small.triangle_points(t).iter().map(|p| p.x).sum::<f64>() / 3.0;
        if (mean - middle).abs() > 0.1 {
            assert!(!folded(triangle, mean > middle), "triangle {t}");
        }
    }
    // the texture is a function of the place: half of a triangle's width off at most
    for (w, &v) in small.wedge_vertices.iter().enumerate() {
        let [x, y, _] = small.positions[v as usize];
        let [s, t] = [value(uv, w)[0], value(uv, w)[1]];
        let off = (s - x).abs().min((s - (2.0 * middle as f32 + 0.25 - x)).abs()) + (t - y).abs();
        assert!(off < 0.02, "wedge {w}: {off}");
    }
}

#[test]
fn a_texture_slips_no_further_than_it_may() {
    // waves both ways: coarse triangles cannot follow them
    let mut mesh = shapes::grid(48);
    let uv =
        mesh.positions.iter().flat_map(|p| [p[0] + 0.02 * (30.0 * p[0]).sin() * (30.0 * p[1]).sin(), p[1]]).collect();
    mesh.wedge_attributes.push(Attribute::new_f32(Semantic::TexCoord(0), 2, uv));
    let most = 0.002;
    let (small, report) = reduced(&mesh, &SimplifyOptions { max_texture_error: Some(most), ..to(100) });
    assert!(report.stopped == Stop::NoLegalCollapse && report.refused.texture > 0, "{report:?}");
    assert!(report.attributes[0].error <= most && small.triangle_count() < mesh.triangle_count() / 2, "{report:?}");
    let tree = crate::measure::Bvh::new(&small);
    for (w, p) in mesh.positions.iter().enumerate() {
        let near = tree.closest(Vec3::from(*p).as_dvec3()).unwrap();
        let corners = small.triangles[near.triangle as usize];
        let found: Vec2 = (0..3)
            .map(|k| Vec2::from_slice(value(texcoords(&small), corners[k] as usize)) * near.barycentric[k] as f32)
            .sum();
        let off = (found - Vec2::from_slice(value(texcoords(&mesh), w))).length();
        assert!(f64::from(off) < 6.0 * most, "{off} at {p:?}");
    }
    let (free, _) = reduced(&mesh, &to(100));
    assert!(free.triangle_count() <= 100);
}

fn texcoords(mesh: &Mesh) -> &Attribute {
    mesh.wedge_attribute(&Semantic::TexCoord(0)).expect("made with texture coordinates")
}

#[test]
fn normals_of_any_length_come_out_unit() {
    let mut mesh = shapes::sphere(3);
    let long = mesh.positions.iter().zip(0..).flat_map(|(p, i)| p.map(|x| x * (1.0 + 5.0 * noise(i)))).collect();
    mesh.wedge_attributes.push(Attribute::new_f32(Semantic::Normal, 3, long));
    let (small, _) = reduced(&mesh, &to(200));
    for w in 0..small.wedge_count() {
        let normal = Vec3::from_slice(value(&small.wedge_attributes[0], w));
        let radial = Vec3::from(small.positions[small.wedge_vertices[w] as usize]).normalize();
        assert!((normal.length() - 1.0).abs() < 1e-5 && normal.dot(radial) > 0.98, "{normal} at {radial}");
    }
}

#[test]
fn what_is_not_finite_does_not_spread() {
    let mut mesh = painted();
    if let Values::F32(values) = &mut mesh.wedge_attributes[0].values {
        values[30] = f32::NAN;
        values[31] = f32::INFINITY;
    }
    let (small, report) = reduced(&mesh, &to(100));
    assert!(small.triangle_count() <= 100 && report.attributes.iter().all(|a| a.error.is_finite()));
    let finite = |a: &Attribute| a.as_f32().unwrap().iter().all(|x| x.is_finite());
    assert!(small.wedge_attributes.iter().all(finite));
}
