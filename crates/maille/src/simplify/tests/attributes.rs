//! Wedges and what they carry through collapses.

use super::*;
use crate::mesh::{MorphTarget, Values};
use crate::topology::CornerTable;

fn texcoords(mesh: &Mesh) -> &Attribute {
    mesh.wedge_attribute(&Semantic::TexCoord(0)).expect("made with texture coordinates")
}

/// Everything that a corner shows, as bits: position, then wedge attributes.
fn corner_bits(mesh: &Mesh) -> std::collections::BTreeSet<Vec<u32>> {
    let bits = |w: usize| {
        let mut all: Vec<u32> = mesh.positions[mesh.wedge_vertices[w] as usize].map(f32::to_bits).to_vec();
        for a in &mesh.wedge_attributes {
            match &a.values {
                Values::F32(x) => all.extend(x[w * a.components..][..a.components].iter().map(|x| x.to_bits())),
                Values::U32(x) => all.extend(&x[w * a.components..][..a.components]),
            }
        }
        all
    };
    (0..mesh.wedge_count()).map(bits).collect()
}

/// Weights of up to eight joints at each wedge.
fn skin(mesh: &mut Mesh, influences: u32) {
    let mut joints = vec![vec![]; 2];
    let mut weights = vec![vec![]; 2];
    for w in 0..mesh.wedge_count() {
        let v = mesh.wedge_vertices[w];
        let raw: Vec<f32> = (0..8).map(|k| if k < influences { 0.1 + noise(8 * v + k) } else { 0.0 }).collect();
        let sum: f32 = raw.iter().sum();
        for k in 0..8 {
            joints[k / 4].push(if (k as u32) < influences { (v / 7 + k as u32) % 30 } else { 0 });
            weights[k / 4].push(raw[k] / sum);
        }
    }
    for (set, (joints, weights)) in (0..).zip(joints.into_iter().zip(weights)) {
        mesh.wedge_attributes.push(Attribute::new_u32(Semantic::Joints(set), 4, joints));
        mesh.wedge_attributes.push(Attribute::new_f32(Semantic::Weights(set), 4, weights));
    }
}

/// (joint, weight) of each influence on a wedge.
fn influences(mesh: &Mesh, wedge: usize) -> Vec<(u32, f32)> {
    let set = |n| {
        let joints = mesh.wedge_attribute(&Semantic::Joints(n)).unwrap().as_u32().unwrap();
        let weights = mesh.wedge_attribute(&Semantic::Weights(n)).unwrap().as_f32().unwrap();
        (4 * wedge..4 * wedge + 4).map(|k| (joints[k], weights[k])).filter(|(_, weight)| *weight != 0.0)
    };
    set(0).chain(set(1)).collect()
}

#[test]
fn texture_coordinates_follow_the_positions() {
    for (metric, placement, way) in every_way() {
        let mut mesh = shapes::grid(16);
        let uv = mesh.positions.iter().flat_map(|p| [p[0], 2.0 - p[1]]).collect();
        mesh.wedge_attributes.push(Attribute::new_f32(Semantic::TexCoord(0), 2, uv));
        let (result, _) = reduced(&mesh, &SimplifyOptions { metric, placement, ..to(60) });
        for w in 0..result.wedge_count() {
            let (p, uv) = (result.positions[result.wedge_vertices[w] as usize], value(texcoords(&result), w));
            // these move vertices off the edge, along which attributes are interpolated, even where all is flat
            let spreads = [MetricKind::ProbabilisticPlane, MetricKind::ProbabilisticTriangle, MetricKind::LineQuadrics];
            let most = if spreads.contains(&metric) { 0.1 } else { 1e-4 };
            assert!((p[0] - uv[0]).abs() < most && (2.0 - p[1] - uv[1]).abs() < most, "{way}: {p:?} shows {uv:?}");
        }
    }
}

#[test]
fn the_seam_of_a_cylinder_stays_closed_and_straight() {
    let mesh = cylinder(48, 16);
    for (metric, placement, way) in every_way() {
        let (result, report) =
            reduced(&mesh, &SimplifyOptions { metric, placement, seams: EdgePolicy::Preserve, ..to(200) });
        assert!(result.triangle_count() <= 210, "{way}: {report:?}");
        let table = CornerTable::of_vertices(&result);
        assert_eq!((table.boundary_loops().len(), table.euler_characteristic()), (2, 0), "{way}");
        let mut sides = BTreeMap::<u32, Vec<[f32; 2]>>::new();
        for w in 0..result.wedge_count() {
            let (v, uv) = (result.wedge_vertices[w], value(texcoords(&result), w));
            assert!(uv.iter().all(|x| (0.0..=1.0).contains(x)), "{way}: {uv:?}");
            sides.entry(v).or_default().push([uv[0], uv[1]]);
            let [x, y, z] = result.positions[v as usize];
            let angle = y.atan2(x) / std::f32::consts::TAU;
            let off = (angle - uv[0] + 1.5).fract() - 0.5;
            assert!(off.abs() < 0.02 && (z - uv[1]).abs() < 0.05, "{way}: {:?} shows {uv:?}", [x, y, z]);
        }
        let on_seam: Vec<_> = sides.values().filter(|uvs| uvs.len() > 1).collect();
        assert!(on_seam.len() >= 2, "{way}");
        for uvs in on_seam {
            let (low, high) = (uvs[0][0].min(uvs[1][0]), uvs[0][0].max(uvs[1][0]));
            // where texture coordinates count in the metric, both sides are solved for on their own
            let same_height = (uvs[0][1] - uvs[1][1]).abs() < 2e-5;
            assert!(uvs.len() == 2 && low < 1e-6 && high > 1.0 - 1e-6 && same_height, "{way}: {uvs:?}");
        }
        let is_seam = |u: f32| (u - u.round()).abs() < 1e-6;
        assert_eq!(sides.values().filter(|uvs| is_seam(uvs[0][0]) && uvs.len() == 1).count(), 0, "{way}");
    }
}

#[test]
fn the_sides_of_a_cube_keep_their_normals() {
    let mesh = flat_cube(6);
    for normals in [NormalPolicy::Interpolate, NormalPolicy::Recompute] {
        let (result, report) = reduced(&mesh, &SimplifyOptions { normals, ..to(12) });
        assert_eq!((result.triangle_count(), result.vertex_count(), result.wedge_count()), (12, 8, 24));
        assert!(report.error < 1e-5, "{report:?}");
        let attribute = result.wedge_attribute(&Semantic::Normal).unwrap();
        for t in 0..12 {
            let [a, b, c] = result.triangle_points(t);
            let normal = (b - a).cross(c - a).normalize().as_vec3();
            for w in result.triangles[t] {
                let shown = glam::Vec3::from_slice(value(attribute, w as usize));
                assert!(shown.distance(normal) < 1e-5, "{normals:?}: {shown} for {normal}");
            }
        }
    }
}

#[test]
fn normals_are_unit_and_right_on_a_sphere() {
    for normals in [NormalPolicy::Interpolate, NormalPolicy::Recompute] {
        for (metric, placement, way) in every_way() {
            let mut mesh = shapes::sphere(4);
            let radial = mesh.positions.iter().flatten().copied().collect();
            mesh.wedge_attributes.push(Attribute::new_f32(Semantic::Normal, 3, radial));
            let (result, _) = reduced(&mesh, &SimplifyOptions { metric, placement, normals, ..to(500) });
            let attribute = result.wedge_attribute(&Semantic::Normal).unwrap();
            for w in 0..result.wedge_count() {
                let normal = glam::Vec3::from_slice(value(attribute, w));
                let radial = glam::Vec3::from(result.positions[result.wedge_vertices[w] as usize]).normalize();
                assert!((normal.length() - 1.0).abs() < 1e-5, "{way}: {normal}");
                // shortest edges leave bent stars
                let least = if metric == MetricKind::ShortestEdge { 0.5 } else { 0.97 };
                assert!(normal.dot(radial) > least, "{way}, {normals:?}: {normal} at {radial}");
            }
        }
    }
}

#[test]
fn opposite_normals_do_not_cancel() {
    let mut mesh = shapes::grid(8);
    let normals = (0..mesh.wedge_count()).flat_map(|w| [0.0, 0.0, if w % 2 == 0 { 1.0 } else { -1.0 }]).collect();
    let tangents = (0..mesh.wedge_count()).flat_map(|w| [if w % 2 == 0 { 1.0 } else { -1.0 }, 0.0, 0.0, -1.0]);
    mesh.wedge_attributes.push(Attribute::new_f32(Semantic::Normal, 3, normals));
    mesh.wedge_attributes.push(Attribute::new_f32(Semantic::Tangent, 4, tangents.collect()));
    for (metric, placement, way) in every_way() {
        let (result, _) = reduced(&mesh, &SimplifyOptions { metric, placement, ..to(20) });
        for (attribute, w) in result.wedge_attributes.iter().flat_map(|a| (0..a.len()).map(move |w| (a, w))) {
            let shown = value(attribute, w);
            let length = shown[..3].iter().map(|x| x * x).sum::<f32>().sqrt();
            assert!((length - 1.0).abs() < 1e-5, "{way}: {shown:?}");
            assert!(shown.len() == 3 || shown[3] == -1.0, "{way}: {shown:?}");
        }
    }
}

#[test]
fn corners_that_stay_keep_their_bits() {
    let mut mesh = dented_torus();
    let count = mesh.wedge_count();
    let random = |n: usize| (0..(n * count) as u32).map(|i| noise(i + 77)).collect::<Vec<f32>>();
    mesh.wedge_attributes.push(Attribute::new_f32(Semantic::Color(0), 4, random(4)));
    mesh.wedge_attributes.push(Attribute::new_f32(Semantic::Custom("heat".into()), 1, random(1)));
    mesh.wedge_attributes.push(Attribute::new_u32(Semantic::Custom("label".into()), 1, (0..count as u32).collect()));
    skin(&mut mesh, 5);
    let normals = mesh.positions.iter().flat_map(|p| glam::Vec3::from(*p).normalize().to_array()).collect();
    mesh.wedge_attributes.push(Attribute::new_f32(Semantic::Normal, 3, normals));
    for mesh in [mesh, cylinder(24, 12)] {
        let before = corner_bits(&mesh);
        assert_eq!(before.len(), mesh.wedge_count());
        for metric in MetricKind::NAMES.map(|(_, metric)| metric) {
            let options = SimplifyOptions { metric, placement: PlacementKind::Subset, ..to(150) };
            let after = corner_bits(&reduced(&mesh, &options).0);
            assert!(after.is_subset(&before), "{metric:?}: half-edge collapses make no new corners");
        }
        let (result, _) = reduced(&mesh, &to(mesh.triangle_count() - 4));
        assert!(corner_bits(&result).difference(&before).count() <= 12, "few collapses touch few corners");
    }
}

#[test]
fn labels_are_chosen_and_never_mixed() {
    let mut mesh = terrain(16);
    let labels: Vec<u32> = (0..mesh.wedge_count()).map(|w| if mesh.positions[w][0] < 0.5 { 3 } else { 1000 }).collect();
    mesh.wedge_attributes.push(Attribute::new_u32(Semantic::Custom("label".into()), 1, labels.clone()));
    mesh.vertex_attributes.push(Attribute::new_u32(Semantic::Custom("mark".into()), 1, labels));
    for (metric, placement, way) in every_way() {
        let (result, _) = reduced(&mesh, &SimplifyOptions { metric, placement, ..to(80) });
        for attribute in [&result.wedge_attributes[0], &result.vertex_attributes[0]] {
            for (label, p) in attribute.as_u32().unwrap().iter().zip(&result.positions) {
                let expected = if p[0] < 0.5 { 3 } else { 1000 };
                assert!(*label == expected || (p[0] - 0.5).abs() < 0.2, "{way}: {label} at {p:?}");
                assert!([3, 1000].contains(label), "{way}");
            }
        }
    }
}

#[test]
fn vertex_attributes_are_interpolated() {
    let mut mesh = shapes::grid(16);
    let heat = mesh.positions.iter().map(|p| 3.0 * p[0] - p[1]).collect();
    mesh.vertex_attributes.push(Attribute::new_f32(Semantic::Custom("heat".into()), 1, heat));
    let (result, _) = reduced(&mesh, &to(40));
    let heat = result.vertex_attributes[0].as_f32().unwrap();
    assert!(heat.iter().zip(&result.positions).all(|(h, p)| (h - 3.0 * p[0] + p[1]).abs() < 1e-4));
}

#[test]
fn triangle_attributes_stay_with_their_triangles() {
    let mut mesh = shapes::grid(16);
    let side = |mesh: &Mesh, t| u32::from(mesh.triangle_points(t).iter().map(|p| p.x).sum::<f64>() > 1.5);
    mesh.triangle_materials = (0..mesh.triangle_count()).map(|t| side(&mesh, t)).collect();
    let labels = mesh.triangle_materials.iter().map(|m| 10 + m).collect();
    mesh.triangle_attributes.push(Attribute::new_u32(Semantic::Custom("part".into()), 1, labels));
    let (result, _) = reduced(&mesh, &to(40));
    let parts = result.triangle_attributes[0].as_u32().unwrap();
    assert!((0..result.triangle_count()).all(|t| parts[t] == 10 + result.triangle_material(t)));
}

#[test]
fn weights_sum_to_one_within_the_limit() {
    let mut mesh = dented_torus();
    skin(&mut mesh, 6);
    for limit in [None, Some(4), Some(1), Some(99)] {
        for placement in PlacementKind::NAMES.map(|(_, placement)| placement) {
            let options = SimplifyOptions { placement, max_influences: limit, ..to(700) };
            let (result, _) = reduced(&mesh, &options);
            for w in 0..result.wedge_count() {
                let mut all = influences(&result, w);
                let sum: f32 = all.iter().map(|(_, weight)| weight).sum();
                assert!((sum - 1.0).abs() < 1e-5, "{limit:?}, {placement:?}: {all:?}");
                assert!(all.len() <= limit.unwrap_or(8).min(8) as usize, "{limit:?}, {placement:?}: {all:?}");
                let count = all.len();
                all.sort_by_key(|(joint, _)| *joint);
                all.dedup_by_key(|(joint, _)| *joint);
                assert_eq!(all.len(), count, "each joint once");
            }
        }
    }
}

#[test]
fn morph_targets_are_interpolated_with_and_without_other_attributes() {
    let mut plain = shapes::grid(16);
    let deltas = plain.positions.iter().flat_map(|p| [p[1], 0.0, 2.0 * p[0]]).collect();
    let delta = Attribute::new_f32(Semantic::Position, 3, deltas);
    plain.morph_targets.push(MorphTarget { name: "bend".into(), attributes: vec![delta] });
    let mut with_colours = plain.clone();
    let colours = vec![0.5; 3 * plain.wedge_count()];
    with_colours.wedge_attributes.push(Attribute::new_f32(Semantic::Color(0), 3, colours));
    for mesh in [plain, with_colours] {
        for (name, placement) in PlacementKind::NAMES {
            let (result, _) = reduced(&mesh, &SimplifyOptions { placement, ..to(60) });
            let deltas = &result.morph_targets[0].attributes[0];
            for (w, p) in result.positions.iter().enumerate() {
                let delta = value(deltas, w);
                let off = (delta[0] - p[1]).abs() + delta[1].abs() + (delta[2] - 2.0 * p[0]).abs();
                assert!(off < 1e-4, "{name}: {delta:?} at {p:?}");
            }
        }
    }
}

#[test]
fn creases_do_not_crack_when_the_mesh_moves() {
    let mut mesh = flat_cube(8);
    for (i, p) in (0..).zip(&mut mesh.positions) {
        *p = [0, 1, 2].map(|k| p[k as usize] + 0.2 * noise(3 * i + k));
    }
    let deltas = mesh.wedge_vertices.iter().flat_map(|&v| [0, 1, 2].map(|k| noise(900 + 3 * v + k))).collect();
    let delta = Attribute::new_f32(Semantic::Position, 3, deltas);
    mesh.morph_targets.push(MorphTarget { name: "shake".into(), attributes: vec![delta] });
    skin(&mut mesh, 4);
    for (metric, placement, way) in every_way() {
        let (result, _) = reduced(&mesh, &SimplifyOptions { metric, placement, ..to(150) });
        let mut of_vertex = BTreeMap::new();
        for w in 0..result.wedge_count() {
            let mut skin = influences(&result, w);
            skin.sort_by_key(|(joint, _)| *joint);
            let moves = (value(&result.morph_targets[0].attributes[0], w).to_vec(), skin);
            let known = of_vertex.entry(result.wedge_vertices[w]).or_insert_with(|| moves.clone());
            let near = |a: f32, b: f32| (a - b).abs() < 1e-5;
            let alike = known.0.iter().zip(&moves.0).all(|(a, b)| near(*a, *b))
                && known.1.len() == moves.1.len()
                && known.1.iter().zip(&moves.1).all(|(a, b)| a.0 == b.0 && near(a.1, b.1));
            assert!(alike, "{way}: two wedges of a vertex go apart: {known:?} and {moves:?}");
        }
        assert!(result.wedge_count() > result.vertex_count(), "{way}: creases are left");
    }
}

#[test]
fn what_has_no_seam_at_a_crease_stays_without_one() {
    // texture coordinates follow the position on a cube whose normals jump at its edges
    let mut mesh = flat_cube(8);
    let place = |mesh: &Mesh, w: usize| mesh.positions[mesh.wedge_vertices[w] as usize];
    let uv = (0..mesh.wedge_count()).flat_map(|w| place(&mesh, w)).collect();
    mesh.wedge_attributes.push(Attribute::new_f32(Semantic::Custom("place".into()), 3, uv));
    for (metric, placement, way) in every_way() {
        let (result, _) = reduced(&mesh, &SimplifyOptions { metric, placement, ..to(150) });
        let attribute = result.wedge_attribute(&Semantic::Custom("place".into())).unwrap();
        let mut shown = BTreeMap::new();
        for w in 0..result.wedge_count() {
            let known = shown.entry(result.wedge_vertices[w]).or_insert_with(|| value(attribute, w).to_vec());
            assert_eq!(*known, value(attribute, w), "{way}: a seam where there was none");
        }
    }
}

#[test]
fn skins_of_no_known_form_are_attributes_like_others() {
    let mut mesh = terrain(12);
    let count = mesh.wedge_count();
    mesh.wedge_attributes.push(Attribute::new_f32(Semantic::Weights(0), 3, vec![0.25; 3 * count]));
    mesh.wedge_attributes.push(Attribute::new_f32(Semantic::Joints(0), 4, vec![1.0; 4 * count]));
    mesh.wedge_attributes.push(Attribute::new_u32(Semantic::Weights(1), 1, vec![7; count]));
    let (result, _) = reduced(&mesh, &SimplifyOptions { max_influences: Some(1), ..to(60) });
    let attributes = &result.wedge_attributes;
    assert!(attributes[0].as_f32().unwrap().iter().all(|x| (x - 0.25).abs() < 1e-6));
    assert!(attributes[2].as_u32().unwrap().iter().all(|x| *x == 7));
}
