//! What geomorphs promise, on levels made by merging vertices at random.

use glam::{DMat4, DVec3, Vec2, Vec3};
use proptest::prelude::*;

use super::*;
use crate::mesh::{Attribute, MeshError, Semantic, shapes};
use crate::zoo::zoo;
use crate::{Mesh, color};

/// A number between -1 and 1 that depends on all of its arguments.
fn noise(seed: u64, index: usize) -> f32 {
    let mut x = seed.wrapping_mul(0x9e37_79b9_7f4a_7c15) ^ (index as u64).wrapping_mul(0xd6e8_feb8_6659_fd93);
    for _ in 0..3 {
        x = (x ^ (x >> 32)).wrapping_mul(0xd6e8_feb8_6659_fd93);
    }
    (x >> 40) as f32 / 8_388_608.0 - 1.0
}

fn unit_vectors(seed: u64, count: usize) -> Vec<[f32; 3]> {
    let vector = |i| Vec3::from([0, 1, 2].map(|k| noise(seed, 3 * i + k))).normalize_or(Vec3::Z).to_array();
    (0..count).map(vector).collect()
}

/// Gives a mesh attributes of all kinds with values by chance.
fn painted(mut mesh: Mesh, seed: u64) -> Mesh {
    let (wedges, vertices) = (mesh.wedge_count(), mesh.vertex_count());
    let floats = |seed: u64, count: usize| (0..count).map(|i| noise(seed, i)).collect::<Vec<f32>>();
    let shares = |seed: u64, count: usize| floats(seed, count).iter().map(|x| x.abs()).collect::<Vec<f32>>();
    let tangents = unit_vectors(seed + 1, wedges).into_iter().enumerate();
    let tangents = tangents.flat_map(|(i, [x, y, z])| [x, y, z, noise(seed + 2, i).signum()]).collect();
    let joints = shares(seed + 3, 4 * wedges).iter().map(|x| (x * 4.0) as u32).collect();
    let mut weights = shares(seed + 4, 4 * wedges);
    for set in weights.as_chunks_mut::<4>().0 {
        let sum: f32 = set.iter().sum::<f32>().max(1e-3);
        *set = set.map(|weight| weight / sum);
    }
    let mut srgb = Attribute::new_f32(Semantic::Color(1), 4, shares(seed + 6, 4 * wedges));
    srgb.storage.srgb = true;
    mesh.wedge_attributes = vec![
        Attribute::new_f32(Semantic::Normal, 3, unit_vectors(seed, wedges).into_flattened()),
        Attribute::new_f32(Semantic::Tangent, 4, tangents),
        Attribute::new_f32(Semantic::TexCoord(0), 2, shares(seed + 5, 2 * wedges)),
        Attribute::new_f32(Semantic::Color(0), 3, shares(seed + 7, 3 * wedges)),
        srgb,
        Attribute::new_u32(Semantic::Joints(0), 4, joints),
        Attribute::new_f32(Semantic::Weights(0), 4, weights),
        Attribute::new_f32(Semantic::Custom("_FIVE".into()), 5, floats(seed + 8, 5 * wedges)),
    ];
    mesh.vertex_attributes = vec![Attribute::new_f32(Semantic::Custom("_HEAT".into()), 1, floats(seed + 9, vertices))];
    mesh
}

/// A level in which vertices have merged by chance, in pairs and chains, and lie elsewhere if `moves`.
fn merged(finer: &Mesh, seed: u64, moves: bool) -> (Mesh, Correspondence) {
    let merge = |v: usize| {
        let target = (noise(seed, v).abs() * v as f32) as u32;
        if noise(seed + 1, v) < 0.2 { v as u32 } else { target }
    };
    let mut root: Vec<u32> = (0..finer.vertex_count()).map(merge).collect();
    for v in 0..root.len() {
        root[v] = root[root[v] as usize];
    }
    let kept: Vec<u32> = (0..root.len() as u32).filter(|&v| root[v as usize] == v).collect();
    let number = |v: u32| kept.binary_search(&root[v as usize]).expect("roots are kept") as u32;
    let positions = kept.iter().map(|&v| finer.positions[v as usize]);
    let shift = |i: usize| if moves { 0.1 * noise(seed + 2, i) } else { 0.0 };
    let positions = positions.enumerate().map(|(i, p)| [p[0] + shift(3 * i), p[1], p[2] + shift(3 * i + 1)]).collect();
    let wedges: Vec<u32> = finer.wedge_vertices.iter().map(|&v| number(v)).collect();
    let triangles = finer.triangles.iter().map(|t| t.map(|w| wedges[w as usize]));
    let triangles = triangles.filter(|t| t[0] != t[1] && t[1] != t[2] && t[2] != t[0]).collect();
    let coarser = Mesh::from_triangles(positions, triangles).unwrap();
    (coarser, Correspondence { wedges, vanishing: Vec::new(), coarser_wedges: kept.len() as u32 })
}

fn all_options() -> impl Iterator<Item = GeomorphOptions> {
    let normals = [NormalInterpolation::Linear, NormalInterpolation::NormalizedLinear, NormalInterpolation::Spherical];
    let colors = [ColorInterpolation::Rgb, ColorInterpolation::Luv];
    normals.into_iter().flat_map(move |normals| colors.map(|colors| GeomorphOptions { normals, colors }))
}

/// Bits of everything, so that zeros and NaN count.
fn bits(mesh: &MorphedMesh) -> Vec<u32> {
    let attribute = |attribute: &Attribute| match attribute.as_f32() {
        Some(values) => values.iter().map(|x| x.to_bits()).collect(),
        None => attribute.as_u32().unwrap().to_vec(),
    };
    let positions = mesh.positions.as_flattened().iter().map(|x| x.to_bits());
    positions.chain(mesh.attributes.iter().flat_map(attribute)).collect()
}

/// What the finer level is at the end: element by element what the correspondence tells.
fn expected_end(finer: &Mesh, coarser: &Mesh, correspondence: &Correspondence) -> MorphedMesh {
    let (mut end, all) = (MorphedMesh::new(finer), MorphedMesh::new(coarser));
    for wedge in 0..finer.wedge_count() {
        let target = match correspondence.target(wedge as u32) {
            Target::Wedge(target) => target as usize,
            Target::Point(point) => {
                end.positions[wedge] = point;
                continue;
            }
        };
        end.positions[wedge] = all.positions[target];
        for attribute in &mut end.attributes {
            let (n, other) = (attribute.components, all.attribute(&attribute.semantic).unwrap());
            match (&mut attribute.values, &other.values) {
                (crate::mesh::Values::F32(a), crate::mesh::Values::F32(b)) => {
                    a[wedge * n..][..n].copy_from_slice(&b[target * n..][..n]);
                }
                (crate::mesh::Values::U32(a), crate::mesh::Values::U32(b)) => {
                    a[wedge * n..][..n].copy_from_slice(&b[target * n..][..n]);
                }
                _ => unreachable!(),
            }
        }
    }
    end
}

fn morphed(geomorph: &Geomorph, finer: &Mesh, t: f32) -> MorphedMesh {
    let mut out = MorphedMesh::new(finer);
    geomorph.morph(t, &mut out);
    out
}

fn vectors(mesh: &MorphedMesh, semantic: &Semantic) -> Vec<Vec3> {
    let attribute = mesh.attribute(semantic).unwrap();
    attribute.as_f32().unwrap().chunks_exact(attribute.components).map(Vec3::from_slice).collect()
}

/// Two meshes of points only with one normal each.
fn turning(from: &[Vec3], to: &[Vec3]) -> [Mesh; 2] {
    [from, to].map(|normals| {
        let mut mesh = Mesh::from_triangles(vec![[0.0; 3]; normals.len()], Vec::new()).unwrap();
        let values = normals.iter().flat_map(|n| n.to_array()).collect();
        mesh.set_wedge_attribute(Attribute::new_f32(Semantic::Normal, 3, values));
        mesh
    })
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(64))]

    #[test]
    fn both_ends_are_exact(seed in 0..u64::MAX / 2, moves in any::<bool>()) {
        for mut finer in [painted(shapes::sphere(3), seed), painted(shapes::grid(5), seed)] {
            finer.positions[3] = [-0.0, f32::INFINITY, f32::NAN];
            let (coarser, correspondence) = merged(&finer, seed + 20, moves);
            let coarser = painted(coarser, seed + 30);
            for options in all_options() {
                let geomorph = Geomorph::new(&finer, &coarser, &correspondence, &options).unwrap();
                let (start, end) = (MorphedMesh::new(&finer), expected_end(&finer, &coarser, &correspondence));
                let mut out = start.clone();
                for t in [0.4, 1.0, 0.7, 0.0, f32::INFINITY, f32::NAN, 7.0, -1.0] {
                    geomorph.morph(t, &mut out);
                    let known = if t >= 1.0 { &end } else { &start };
                    prop_assert!((t > 0.0 && t < 1.0) || bits(known) == bits(&out), "{} {:?}", t, options);
                }
            }
        }
    }

    #[test]
    fn faces_that_remain_are_those_of_the_coarser_level(seed in 0..u64::MAX / 2) {
        let finer = shapes::torus(2.0, 0.5, 12, 9);
        let (coarser, correspondence) = merged(&finer, seed, true);
        let geomorph = Geomorph::new(&finer, &coarser, &correspondence, &GeomorphOptions::default()).unwrap();
        let end = morphed(&geomorph, &finer, 1.0);
        let corners = |positions: &[[f32; 3]], t: [u32; 3]| t.map(|w| positions[w as usize].map(f32::to_bits));
        let proper = finer.triangles.iter().map(|&t| corners(&end.positions, t));
        let proper: Vec<_> = proper.filter(|[a, b, c]| a != b && b != c && c != a).collect();
        let wanted: Vec<_> = coarser.triangles.iter().map(|&t| corners(&coarser.positions, t)).collect();
        prop_assert_eq!(proper, wanted);
    }

    #[test]
    fn positions_and_other_values_go_straight(seed in 0..u64::MAX / 2, t in 0.01_f32..0.99) {
        let finer = painted(shapes::sphere(2), seed);
        let (coarser, correspondence) = merged(&finer, seed, true);
        let coarser = painted(coarser, seed + 1);
        let geomorph = Geomorph::new(&finer, &coarser, &correspondence, &GeomorphOptions::default()).unwrap();
        let [start, now, end] = [0.0, t, 1.0].map(|t| morphed(&geomorph, &finer, t));
        let five = Semantic::Custom("_FIVE".into());
        let values = |mesh: &MorphedMesh| {
            let more = [&five, &Semantic::Color(0)].map(|s| mesh.attribute(s).unwrap().as_f32().unwrap().to_vec());
            [mesh.positions.as_flattened().to_vec(), more.concat()].concat()
        };
        for ((a, b), x) in values(&start).iter().zip(values(&end)).zip(values(&now)) {
            // what stays as a whole is not touched
            prop_assert!(x == a * (1.0 - t) + b * t || (*a == b && x == *a), "{} {} {}", a, b, x);
        }
        let joints = |mesh: &MorphedMesh| mesh.attribute(&Semantic::Joints(0)).unwrap().clone();
        let weights = |mesh: &MorphedMesh| mesh.attribute(&Semantic::Weights(0)).unwrap().clone();
        let nearer = if t < 0.5 { &start } else { &end };
        prop_assert!(joints(&now) == joints(nearer) && weights(&now) == weights(nearer));
    }

    #[test]
    fn normals_and_tangents_stay_unit_vectors(seed in 0..u64::MAX / 2, t in 0.0_f32..1.0) {
        let mut finer = painted(shapes::sphere(3), seed);
        // as if they had been stored with 8 bits
        let coarse = finer.wedge_attributes[0].as_f32_mut().unwrap();
        coarse.iter_mut().take(90).for_each(|x| *x = (*x * 127.0).round() / 127.0);
        let (coarser, correspondence) = merged(&finer, seed, true);
        let coarser = painted(coarser, seed + 1);
        for normals in [NormalInterpolation::NormalizedLinear, NormalInterpolation::Spherical] {
            let options = GeomorphOptions { normals, ..GeomorphOptions::default() };
            let geomorph = Geomorph::new(&finer, &coarser, &correspondence, &options).unwrap();
            let now = morphed(&geomorph, &finer, t.max(1e-6));
            let is_nearly_unit = |tolerance: f32| move |v: &Vec3| (v.length() - 1.0).abs() < tolerance;
            let all = [vectors(&now, &Semantic::Normal), vectors(&now, &Semantic::Tangent)].concat();
            // normals that stay (here: switch) keep the length that they came with
            prop_assert!(all.iter().all(is_nearly_unit(2e-2)));
            prop_assert!(all.iter().filter(|v| !is_nearly_unit(2e-5)(v)).count() < 30);
            let signs = now.attribute(&Semantic::Tangent).unwrap().as_f32().unwrap();
            prop_assert!(signs.as_chunks::<4>().0.iter().all(|tangent| tangent[3].abs() == 1.0));
        }
    }

    #[test]
    fn what_does_not_move_is_not_touched(seed in 0..u64::MAX / 2, t in 0.0_f32..1.0) {
        let finer = painted(shapes::sphere(2), seed);
        let mut coarser = finer.clone();
        let changed = |v: usize| noise(seed, v) < 0.0;
        for (v, p) in coarser.positions.iter_mut().enumerate().filter(|(v, _)| changed(*v)) {
            p[0] += 1.0 + v as f32;
        }
        let correspondence = Correspondence::identity(finer.wedge_count() as u32);
        let geomorph = Geomorph::new(&finer, &coarser, &correspondence, &GeomorphOptions::default()).unwrap();
        let moving = (0..finer.vertex_count()).filter(|&v| changed(v)).count();
        prop_assert_eq!(geomorph.interpolations(), moving);
        let mut out = MorphedMesh::new(&finer);
        let marker = [f32::NAN; 3];
        (0..out.positions.len()).filter(|&v| !changed(v)).for_each(|v| out.positions[v] = marker);
        geomorph.morph(t, &mut out);
        prop_assert!((0..out.positions.len()).all(|v| out.positions[v][0].is_nan() != changed(v)));
    }

    #[test]
    fn correspondences_chain(seed in 0..u64::MAX / 2) {
        let random = |seed: u64, from: usize, to: u32, points: usize| {
            let target = |i| (noise(seed, i).abs() * (to as usize + points) as f32) as u32;
            let vanishing = (0..points).map(|i| [noise(seed + 1, i); 3]).collect();
            Correspondence { wedges: (0..from).map(target).collect(), vanishing, coarser_wedges: to }
        };
        let (a, b, c) = (random(seed, 50, 30, 3), random(seed + 1, 30, 11, 0), random(seed + 2, 11, 4, 2));
        prop_assert_eq!(a.then(&b).then(&c), a.then(&b.then(&c)));
        prop_assert_eq!(&Correspondence::identity(50).then(&a), &a);
        prop_assert_eq!(&a.then(&Correspondence::identity(30)), &a);
        let both = a.then(&b).then(&c);
        for wedge in 0..50 {
            let step = |target: Target, next: &Correspondence| match target {
                Target::Wedge(wedge) => next.target(wedge),
                point @ Target::Point(_) => point,
            };
            prop_assert_eq!(both.target(wedge), step(step(a.target(wedge), &b), &c));
        }
    }

    #[test]
    fn arcs_are_walked_at_constant_speed(seed in 0..u64::MAX / 2) {
        let to_vectors = |seed| unit_vectors(seed, 20).into_iter().map(Vec3::from).collect::<Vec<_>>();
        let (mut from, mut to) = (to_vectors(seed), to_vectors(seed + 1));
        // and the hard cases: opposite, nearly opposite, nearly the same
        from.extend([Vec3::X, Vec3::X, Vec3::Y]);
        to.extend([-Vec3::X, Vec3::new(-1.0, 1e-4, 0.0).normalize(), Vec3::new(1e-4, 1.0, 0.0).normalize()]);
        let [finer, coarser] = turning(&from, &to);
        let options = GeomorphOptions { normals: NormalInterpolation::Spherical, ..GeomorphOptions::default() };
        let correspondence = Correspondence::identity(from.len() as u32);
        let geomorph = Geomorph::new(&finer, &coarser, &correspondence, &options).unwrap();
        for t in [0.1, 0.25, 0.5, 0.9] {
            let now = vectors(&morphed(&geomorph, &finer, t), &Semantic::Normal);
            for ((a, b), n) in from.iter().zip(&to).zip(now) {
                let angle = |a: &Vec3, b: &Vec3| {
                    let (a, b) = (a.as_dvec3(), b.as_dvec3());
                    a.cross(b).length().atan2(a.dot(b))
                };
                prop_assert!((angle(a, &n) - f64::from(t) * angle(a, b)).abs() < 1e-5, "{a} {b} {n}");
                prop_assert!((angle(&n, b) - f64::from(1.0 - t) * angle(a, b)).abs() < 1e-5, "{a} {b} {n}");
            }
        }
    }

    #[test]
    fn normalised_lines_are_what_they_are_called(seed in 0..u64::MAX / 2, t in 0.01_f32..0.99) {
        let to_vectors = |seed| unit_vectors(seed, 27).into_iter().map(Vec3::from).collect::<Vec<_>>();
        let (from, to) = (to_vectors(seed), to_vectors(seed + 1));
        let [finer, coarser] = turning(&from, &to);
        let correspondence = Correspondence::identity(27);
        let geomorph = Geomorph::new(&finer, &coarser, &correspondence, &GeomorphOptions::default()).unwrap();
        let now = vectors(&morphed(&geomorph, &finer, t), &Semantic::Normal);
        for ((a, b), n) in from.iter().zip(&to).zip(now).filter(|((a, b), _)| a.dot(**b) > -0.98) {
            let wanted = (a.as_dvec3() * f64::from(1.0 - t) + b.as_dvec3() * f64::from(t)).normalize();
            prop_assert!(n.as_dvec3().distance(wanted) < 3e-5, "{a} {b} {n} {wanted}");
        }
    }
}

#[test]
fn opposite_normals_jump_in_the_middle() {
    let [finer, coarser] = turning(&[Vec3::X, Vec3::Y], &[-Vec3::X, Vec3::Z]);
    let geomorph = Geomorph::new(&finer, &coarser, &Correspondence::identity(2), &GeomorphOptions::default()).unwrap();
    for (t, known) in [(0.1, Vec3::X), (0.49, Vec3::X), (0.5, -Vec3::X), (0.9, -Vec3::X)] {
        let now = vectors(&morphed(&geomorph, &finer, t), &Semantic::Normal);
        assert_eq!(now[0], known);
        assert!((now[1].length() - 1.0).abs() < 1e-6);
    }
}

#[test]
fn signs_of_bitangents_jump_in_the_middle() {
    let [mut finer, mut coarser] = turning(&[Vec3::Z], &[Vec3::Z]);
    finer.set_wedge_attribute(Attribute::new_f32(Semantic::Tangent, 4, vec![1.0, 0.0, 0.0, 1.0]));
    coarser.set_wedge_attribute(Attribute::new_f32(Semantic::Tangent, 4, vec![0.0, 1.0, 0.0, -1.0]));
    for options in all_options() {
        let geomorph = Geomorph::new(&finer, &coarser, &Correspondence::identity(1), &options).unwrap();
        let tangent =
            |t| morphed(&geomorph, &finer, t).attribute(&Semantic::Tangent).unwrap().as_f32().unwrap().to_vec();
        assert_eq!((tangent(0.49)[3], tangent(0.5)[3]), (1.0, -1.0));
        let [x, y, z, _] = tangent(0.5)[..] else { unreachable!() };
        let half = if options.normals == NormalInterpolation::Linear { 0.5 } else { 0.5_f32.sqrt() };
        assert!((x - half).abs() < 1e-6 && (y - half).abs() < 1e-6 && z == 0.0, "{options:?} {x} {y} {z}");
    }
}

#[test]
fn colours_are_mixed_in_linear_light_or_in_luv() {
    let colored = |rgb: [f32; 3], srgb| {
        let mut mesh = Mesh::from_triangles(vec![[0.0; 3]], Vec::new()).unwrap();
        let mut attribute = Attribute::new_f32(Semantic::Color(0), 4, vec![rgb[0], rgb[1], rgb[2], rgb[0]]);
        attribute.storage.srgb = srgb;
        mesh.set_wedge_attribute(attribute);
        mesh
    };
    let halfway = |colors, srgb| {
        let (finer, coarser) = (colored([1.0, 0.0, 0.0], srgb), colored([0.0, 0.0, 1.0], srgb));
        let options = GeomorphOptions { colors, ..GeomorphOptions::default() };
        let geomorph = Geomorph::new(&finer, &coarser, &Correspondence::identity(1), &options).unwrap();
        let now = morphed(&geomorph, &finer, 0.5).attributes[0].as_f32().unwrap().to_vec();
        assert_eq!(now[3], 0.5, "alpha goes straight");
        [now[0], now[1], now[2]]
    };
    assert_eq!(halfway(ColorInterpolation::Rgb, false), [0.5, 0.0, 0.5]);
    let near = |found: [f32; 3], known: [f32; 3]| found.iter().zip(known).all(|(a, b)| (a - b).abs() < 2e-3);
    // half of the light is 188 of 255
    assert!(near(halfway(ColorInterpolation::Rgb, true), [0.7354, 0.0, 0.7354]));
    // red is (53.24, 175.01, 37.76), blue (32.30, -9.40, -130.34): the mean of both
    let linear = halfway(ColorInterpolation::Luv, false);
    let luv = color::to_luv(linear).map(|x| x * 100.0);
    for (found, known) in luv.iter().zip([42.77, 82.80, -46.29]) {
        assert!((found - known).abs() < 0.1, "{luv:?}");
    }
    assert!(near(halfway(ColorInterpolation::Luv, true), linear.map(color::to_srgb)));
}

/// Two squares side by side whose charts lie in opposite corners of the atlas.
fn atlas() -> Mesh {
    let positions: Vec<[f32; 3]> =
        (0..3).flat_map(|x| (0..2).map(move |y| [0.1 * x as f32, 0.1 * y as f32, 0.0])).collect();
    let mut mesh = Mesh::from_triangles(positions, Vec::new()).unwrap();
    mesh.wedge_vertices = vec![0, 1, 2, 3, 2, 3, 4, 5];
    mesh.triangles = vec![[0, 2, 3], [0, 3, 1], [4, 6, 7], [4, 7, 5]];
    let uv = [[0.0, 0.0], [0.0, 0.1], [0.1, 0.0], [0.1, 0.1], [0.8, 0.9], [0.8, 1.0], [0.9, 0.9], [0.9, 1.0]];
    mesh.set_wedge_attribute(Attribute::new_f32(Semantic::TexCoord(0), 2, uv.concat()));
    mesh
}

#[test]
fn texture_coordinates_do_not_sweep_across_the_atlas() {
    let finer = atlas();
    let uv = |coarser: &Mesh, wedges: [u32; 8], t, wedge: usize| -> [f32; 2] {
        let correspondence = Correspondence { wedges: wedges.to_vec(), vanishing: Vec::new(), coarser_wedges: 8 };
        let geomorph = Geomorph::new(&finer, coarser, &correspondence, &GeomorphOptions::default()).unwrap();
        let now = morphed(&geomorph, &finer, t);
        now.attribute(&Semantic::TexCoord(0)).unwrap().as_f32().unwrap()[2 * wedge..][..2].try_into().unwrap()
    };

    // the chart of the first square has moved beside the other one: its corners jump together
    let mut moved = finer.clone();
    let beside = [[0.7, 0.9], [0.7, 1.0], [0.8, 0.9], [0.8, 1.0], [0.8, 0.9], [0.8, 1.0], [0.9, 0.9], [0.9, 1.0]];
    moved.set_wedge_attribute(Attribute::new_f32(Semantic::TexCoord(0), 2, beside.concat()));
    let stay = [0, 1, 2, 3, 4, 5, 6, 7];
    for (wedge, before, after) in [(1, [0.0, 0.1], [0.7, 1.0]), (2, [0.1, 0.0], [0.8, 0.9])] {
        let found = [0.3, 0.49, 0.5, 1.0].map(|t| uv(&moved, stay, t, wedge));
        assert_eq!(found, [before, before, after, after]);
    }

    // the second square shrinks to its left edge: within its chart it slides, and what would become a part of the other
    // chart keeps its place until there is nothing left to be seen
    let slides = [0, 1, 2, 3, 4, 5, 4, 5];
    assert!(Vec2::from(uv(&finer, slides, 0.5, 6)).distance(Vec2::new(0.85, 0.9)) < 1e-6);
    let goes_over = [0, 1, 2, 3, 2, 3, 2, 3];
    assert_eq!([0.2, 0.99, 1.0].map(|t| uv(&finer, goes_over, t, 6)), [[0.9, 0.9], [0.9, 0.9], [0.1, 0.0]]);
}

#[test]
fn a_total_morph_scales_each_part_about_its_point() {
    let mut finer = shapes::sphere(2);
    let count = finer.vertex_count();
    let other = shapes::cube();
    finer.positions.extend(other.positions.iter().map(|p| [p[0] + 5.0, p[1], p[2]]));
    finer.wedge_vertices = (0..finer.positions.len() as u32).collect();
    finer.triangles.extend(other.triangles.iter().map(|t| t.map(|w| w + count as u32)));
    let empty = Mesh::default();
    let correspondence = Correspondence::closest(&finer, &empty).unwrap();
    assert_eq!(correspondence.vanishing.len(), 2);
    let geomorph = Geomorph::new(&finer, &empty, &correspondence, &GeomorphOptions::default()).unwrap();
    for t in [0.25, 0.5, 1.0] {
        for (v, p) in morphed(&geomorph, &finer, t).positions.iter().enumerate() {
            let centre = if v < count { Vec3::ZERO } else { Vec3::new(5.0, 0.0, 0.0) };
            let known = centre + (Vec3::from(finer.positions[v]) - centre) * (1.0 - t);
            assert!(known.distance(Vec3::from(*p)) < 1e-5, "{v} {p:?} {known}");
        }
    }
}

#[test]
fn hostile_correspondences_are_refused() {
    let mesh = shapes::tetrahedron();
    let good = Correspondence::identity(4);
    let refused = |correspondence: &Correspondence| {
        let skin = SkinnedGeomorph::new(&mesh, &mesh, correspondence);
        assert!(matches!(skin, Err(SkinError::Geomorph(GeomorphError::Correspondence(_)))));
        match Geomorph::new(&mesh, &mesh, correspondence, &GeomorphOptions::default()) {
            Err(GeomorphError::Correspondence(error)) => error,
            other => panic!("{other:?}"),
        }
    };
    let short = Correspondence { wedges: vec![0; 3], ..good.clone() };
    assert_eq!(refused(&short), CorrespondenceError::FinerWedges { found: 3, expected: 4 });
    let other = Correspondence { coarser_wedges: u32::MAX, ..good.clone() };
    assert_eq!(refused(&other), CorrespondenceError::CoarserWedges { found: u32::MAX as usize, expected: 4 });
    for target in [5, u32::MAX] {
        let outside = Correspondence { wedges: vec![0, 1, target, 4], vanishing: vec![[0.0; 3]], ..good.clone() };
        let known = CorrespondenceError::OutOfRange { wedge: 2, target, wedges: 4, vanishing: 1 };
        assert_eq!(refused(&outside), known);
    }
    let mut broken = mesh.clone();
    broken.triangles[0][0] = 9;
    let found = Geomorph::new(&mesh, &broken, &good, &GeomorphOptions::default());
    assert!(matches!(found, Err(GeomorphError::Mesh { level: Level::Coarser, .. })));
    assert!(matches!(Correspondence::closest(&broken, &mesh), Err(MeshError::WedgeOutOfRange { .. })));
}

#[test]
fn attributes_of_other_forms_are_refused_and_missing_ones_stay() {
    let finer = painted(shapes::tetrahedron(), 1);
    let mut coarser = painted(shapes::tetrahedron(), 2);
    let new =
        |coarser: &Mesh| Geomorph::new(&finer, coarser, &Correspondence::identity(4), &GeomorphOptions::default());
    coarser.wedge_attributes.retain(|attribute| attribute.semantic != Semantic::Normal);
    let geomorph = new(&coarser).unwrap();
    assert_eq!(morphed(&geomorph, &finer, 1.0).attributes[0], finer.wedge_attributes[0]);
    coarser.set_wedge_attribute(Attribute::new_f32(Semantic::Color(0), 4, vec![0.0; 16]));
    assert_eq!(new(&coarser).unwrap_err(), GeomorphError::Form { semantic: Semantic::Color(0) });
}

#[test]
fn odd_shapes_of_attributes_do_no_harm() {
    let odd = |value: f32| {
        let mut mesh = shapes::tetrahedron();
        for (semantic, n) in [
            (Semantic::Normal, 1),
            (Semantic::Tangent, 3),
            (Semantic::Color(0), 1),
            (Semantic::TexCoord(0), 3),
            (Semantic::Custom("_LONG".into()), 3000),
            (Semantic::Custom("_NONE".into()), 0),
        ] {
            mesh.wedge_attributes.push(Attribute::new_f32(semantic, n, vec![value; 4 * n]));
        }
        mesh
    };
    for values in [[0.0, 1.0], [0.0, -0.0], [f32::NAN, f32::INFINITY], [f32::MIN_POSITIVE, f32::MAX]] {
        let [finer, coarser] = values.map(odd);
        for options in all_options() {
            let geomorph = Geomorph::new(&finer, &coarser, &Correspondence::identity(4), &options).unwrap();
            morphed(&geomorph, &finer, 0.3);
            assert_eq!(bits(&morphed(&geomorph, &finer, 1.0)), bits(&MorphedMesh::new(&coarser)));
            geomorph.morph_normals(0.3, &mut [[0.0; 3]; 4]);
            geomorph.deltas();
            geomorph.targets(&finer);
        }
    }
}

#[test]
fn deltas_lead_from_the_finer_level_to_the_coarser_one() {
    let finer = painted(shapes::sphere(2), 5);
    let (coarser, correspondence) = merged(&finer, 6, true);
    let coarser = painted(coarser, 7);
    let geomorph = Geomorph::new(&finer, &coarser, &correspondence, &GeomorphOptions::default()).unwrap();
    let (start, end) = (MorphedMesh::new(&finer), expected_end(&finer, &coarser, &correspondence));
    let shape = geomorph.deltas();
    let semantics: Vec<_> = shape.attributes.iter().map(|delta| &delta.semantic).collect();
    let (uv, colors) = (Semantic::TexCoord(0), [Semantic::Color(0), Semantic::Color(1)]);
    let known = [&Semantic::Position, &Semantic::Normal, &Semantic::Tangent, &uv, &colors[0], &colors[1]];
    assert_eq!(semantics, known);
    for delta in &shape.attributes[3..] {
        let values = |mesh: &MorphedMesh| mesh.attribute(&delta.semantic).unwrap().as_f32().unwrap().to_vec();
        let n = delta.components;
        for (wedge, own) in delta.as_f32().unwrap().chunks_exact(n).enumerate() {
            let [a, b] = [values(&start), values(&end)].map(|all| all[n * wedge..][..n].to_vec());
            let arrives = own.iter().zip(a.iter().zip(&b)).all(|(d, (a, b))| (a + d - b).abs() < 1e-6);
            let stays = own.iter().all(|&d| d == 0.0); // as texture coordinates of what vanishes
            assert!(arrives || stays && delta.semantic == uv, "{} of {wedge}", delta.semantic);
        }
    }
    for delta in &shape.attributes[..3] {
        let of = |mesh: &MorphedMesh| match delta.semantic {
            Semantic::Position => mesh.positions.iter().map(|&p| Vec3::from(p)).collect(),
            _ => vectors(mesh, &delta.semantic),
        };
        let deltas = delta.as_f32().unwrap().as_chunks::<3>().0.iter().map(|&d| Vec3::from(d));
        for ((a, b), d) in of(&start).into_iter().zip(of(&end)).zip(deltas) {
            assert!((a + d).distance(b) < 1e-6);
        }
    }
    let mut with_shape = finer.clone();
    with_shape.morph_targets = vec![shape];
    assert_eq!(with_shape.check(), Ok(()));
}

#[test]
fn targets_are_the_coarser_level_as_attributes() {
    let finer = painted(shapes::sphere(2), 5);
    let (coarser, correspondence) = merged(&finer, 6, true);
    let coarser = painted(coarser, 7);
    let geomorph = Geomorph::new(&finer, &coarser, &correspondence, &GeomorphOptions::default()).unwrap();
    let end = expected_end(&finer, &coarser, &correspondence);
    let targets = geomorph.targets(&finer);
    let names: Vec<_> = targets.iter().map(|target| target.semantic.to_string()).collect();
    let known = ["POSITION", "NORMAL", "TANGENT", "TEXCOORD_0", "COLOR_0", "COLOR_1", "JOINTS_0", "WEIGHTS_0"];
    assert_eq!(names, known.map(|name| format!("_MORPH_{name}")));
    assert_eq!(targets[0].as_f32().unwrap(), end.positions.as_flattened());
    for (target, attribute) in targets[1..].iter().zip(&end.attributes) {
        assert_eq!((&target.values, target.storage), (&attribute.values, attribute.storage));
    }
}

#[test]
fn closest_finds_back_a_level_whose_wedges_are_in_another_order() {
    let mut finer = shapes::cube();
    finer.compute_normals(&crate::mesh::NormalOptions { crease_angle: Some(0.5), ..Default::default() });
    let uv = (0..24).flat_map(|i| [noise(3, i), noise(4, i)]).collect();
    finer.set_wedge_attribute(Attribute::new_f32(Semantic::TexCoord(0), 2, uv));
    let order: Vec<u32> = (0..24).rev().collect();
    let mut coarser = finer.clone();
    coarser.gather_wedges(&order);
    coarser.triangles.iter_mut().for_each(|t| *t = t.map(|w| 23 - w));
    assert_eq!(Correspondence::closest(&finer, &coarser).unwrap().wedges, order);
    assert_eq!(Correspondence::closest(&finer, &finer).unwrap(), Correspondence::identity(24));
}

#[test]
fn closest_takes_anything_and_tears_nothing() {
    let meshes: Vec<Mesh> = zoo().into_iter().map(|specimen| specimen.mesh).collect();
    for finer in &meshes {
        for coarser in &meshes {
            let mut broken = finer.clone();
            if let Some(p) = broken.positions.first_mut() {
                p[1] = f32::NAN;
            }
            for finer in [finer, &broken] {
                let correspondence = Correspondence::closest(finer, coarser).unwrap();
                assert_eq!(correspondence.check(finer, coarser), Ok(()));
                let geomorph = Geomorph::new(finer, coarser, &correspondence, &GeomorphOptions::default()).unwrap();
                let end = morphed(&geomorph, finer, 1.0);
                let mut at = vec![None; finer.vertex_count()];
                for (&v, p) in finer.wedge_vertices.iter().zip(&end.positions) {
                    let bits = p.map(f32::to_bits);
                    assert_eq!(*at[v as usize].get_or_insert(bits), bits);
                }
            }
        }
    }
}

fn pose(seed: u64) -> Vec<JointMatrix> {
    let turn = |i| DMat4::from_axis_angle(DVec3::new(0.6, 0.0, 0.8), 2.0 * f64::from(noise(seed, i)));
    (0..4)
        .map(|i| joint_matrix(&(DMat4::from_translation(DVec3::splat(f64::from(noise(seed, i + 9)))) * turn(i))))
        .collect()
}

fn skinned_levels(seed: u64) -> (Mesh, Mesh, Correspondence) {
    let finer = painted(shapes::sphere(2), seed);
    let (coarser, mut correspondence) = merged(&finer, seed + 1, true);
    let coarser = painted(coarser, seed + 2);
    correspondence.vanishing = vec![[0.5; 3]];
    correspondence.wedges[7] = correspondence.coarser_wedges;
    (finer, coarser, correspondence)
}

/// Skinning so simple that it is right: one wedge after the other, in double precision.
fn skinned_point(mesh: &Mesh, wedge: usize, point: [f32; 3], pose: &[JointMatrix]) -> DVec3 {
    let joints = mesh.wedge_attribute(&Semantic::Joints(0)).unwrap().as_u32().unwrap();
    let weights = mesh.wedge_attribute(&Semantic::Weights(0)).unwrap().as_f32().unwrap();
    let [x, y, z] = point.map(f64::from);
    let moved = |joint: u32| {
        DVec3::from(pose[joint as usize].map(|row| row.map(f64::from)).map(|[a, b, c, d]| a * x + b * y + c * z + d))
    };
    (4 * wedge..4 * wedge + 4).map(|i| moved(joints[i]) * f64::from(weights[i])).sum()
}

#[test]
fn skinned_levels_are_met_at_both_ends() {
    let (finer, coarser, correspondence) = skinned_levels(3);
    let geomorph = SkinnedGeomorph::new(&finer, &coarser, &correspondence).unwrap();
    let pose = pose(4);
    let (mut start, mut targets) = (Posed::default(), Posed::default());
    geomorph.pose(&pose, &mut start, &mut targets).unwrap();
    let own = |wedge: usize| finer.positions[finer.wedge_vertices[wedge] as usize];
    let end = |wedge: usize| match correspondence.target(wedge as u32) {
        Target::Point(point) => skinned_point(&finer, wedge, point, &pose),
        Target::Wedge(target) => {
            let at_rest = coarser.positions[coarser.wedge_vertices[target as usize] as usize];
            skinned_point(&coarser, target as usize, at_rest, &pose)
        }
    };
    for t in [0.0_f32, 0.3, 1.0, f32::NAN] {
        let mut now = start.clone();
        geomorph.morph(t, &mut now, &targets);
        let share = if t.is_nan() { 0.0 } else { f64::from(t) };
        for (wedge, p) in now.positions.iter().enumerate() {
            let known = skinned_point(&finer, wedge, own(wedge), &pose).lerp(end(wedge), share);
            assert!(Vec3::from(*p).as_dvec3().distance(known) < 1e-5, "{wedge} {t}");
        }
        assert!(now.normals.iter().all(|&n| (Vec3::from(n).length() - 1.0).abs() < 1e-5));
        if share == 0.0 {
            assert_eq!(now, start);
        }
    }
    // the end is the coarser level to the bit
    let mut end = start.clone();
    geomorph.morph(1.0, &mut end, &targets);
    for (wedge, &target) in correspondence.wedges.iter().enumerate().filter(|&(wedge, _)| wedge != 7) {
        assert_eq!(
            (end.positions[wedge], end.normals[wedge]),
            (targets.positions[target as usize], targets.normals[target as usize])
        );
    }
}

#[test]
fn skinned_levels_take_their_blend_shapes_along() {
    let (mut finer, mut coarser, correspondence) = skinned_levels(5);
    for (seed, mesh) in [(40, &mut finer), (50, &mut coarser)] {
        let deltas: Vec<f32> = (0..3 * mesh.wedge_count()).map(|i| 0.1 * noise(seed, i)).collect();
        let shape = |name: &str| crate::mesh::MorphTarget {
            name: name.into(),
            attributes: vec![Attribute::new_f32(Semantic::Position, 3, deltas.clone())],
        };
        mesh.morph_targets = vec![shape("smile"), shape("geomorph")];
    }
    let geomorph = SkinnedGeomorph::new(&finer, &coarser, &correspondence).unwrap();
    let pose = pose(6);
    let (mut shown, mut targets) = (Posed::default(), Posed::default());
    geomorph.pose_blended(&pose, &[0.5], &mut shown, &mut targets).unwrap();
    let shaped = |mesh: &Mesh, wedge: usize| {
        let deltas = mesh.morph_targets[0].attributes[0].as_f32().unwrap();
        let at_rest = Vec3::from(mesh.positions[mesh.wedge_vertices[wedge] as usize]);
        skinned_point(mesh, wedge, (at_rest + 0.5 * Vec3::from_slice(&deltas[3 * wedge..])).into(), &pose)
    };
    let near = |p: [f32; 3], known: DVec3| Vec3::from(p).as_dvec3().distance(known) < 1e-5;
    assert!((0..finer.wedge_count()).all(|wedge| near(shown.positions[wedge], shaped(&finer, wedge))));
    geomorph.morph(1.0, &mut shown, &targets);
    for (wedge, &target) in correspondence.wedges.iter().enumerate().filter(|&(wedge, _)| wedge != 7) {
        assert!(near(shown.positions[wedge], shaped(&coarser, target as usize)));
    }
    // the tangents go along, at length 1
    assert_eq!(shown.tangents.len(), finer.wedge_count());
    assert!(shown.tangents.iter().all(|&[x, y, z, _]| (Vec3::new(x, y, z).length() - 1.0).abs() < 1e-5));
    let target = correspondence.wedges[0] as usize;
    assert_eq!(shown.tangents[0], targets.tangents[target], "the end is the coarser level");
}

#[test]
fn all_sets_of_joints_count_and_those_without_weight_need_no_matrix() {
    let mut mesh = shapes::tetrahedron();
    let set = |joints: [u32; 4], weights: [f32; 4], n| {
        let joints = Attribute::new_u32(Semantic::Joints(n), 4, joints.repeat(4));
        [joints, Attribute::new_f32(Semantic::Weights(n), 4, weights.repeat(4))]
    };
    let first = set([0, 1000, 0, 0], [0.5, 0.0, 0.0, 0.0], 0);
    mesh.wedge_attributes = first.into_iter().chain(set([1, 0, 0, 0], [0.5, 0.0, 0.0, 0.0], 1)).collect();
    let geomorph = SkinnedGeomorph::new(&mesh, &mesh, &Correspondence::identity(4)).unwrap();
    let shifted = |x| joint_matrix(&DMat4::from_translation(DVec3::new(x, 0.0, 0.0)));
    let (mut posed, mut targets) = (Posed::default(), Posed::default());
    geomorph.pose(&[shifted(1.0), shifted(3.0)], &mut posed, &mut targets).unwrap();
    assert!(posed.positions.iter().zip(&mesh.positions).all(|(p, q)| p[0] == q[0] + 2.0) && posed.normals.is_empty());
    let too_few = geomorph.pose(&[shifted(1.0)], &mut posed, &mut targets);
    assert_eq!(too_few, Err(SkinError::TooFewMatrices { found: 1, expected: 2 }));
    let plain = shapes::tetrahedron();
    let found = SkinnedGeomorph::new(&mesh, &plain, &Correspondence::identity(4));
    assert!(matches!(found, Err(SkinError::NoSkin { level: Level::Coarser })));
}

#[test]
fn a_skinned_model_may_vanish() {
    let finer = painted(shapes::sphere(2), 1);
    let correspondence = Correspondence::closest(&finer, &Mesh::default()).unwrap();
    let geomorph = SkinnedGeomorph::new(&finer, &Mesh::default(), &correspondence).unwrap();
    let pose = pose(2);
    let (mut posed, mut targets) = (Posed::default(), Posed::default());
    geomorph.pose(&pose, &mut posed, &mut targets).unwrap();
    geomorph.morph(1.0, &mut posed, &targets);
    let known = |wedge| skinned_point(&finer, wedge, correspondence.vanishing[0], &pose);
    assert!((0..posed.positions.len()).all(|w| Vec3::from(posed.positions[w]).as_dvec3().distance(known(w)) < 1e-5));
}

#[test]
fn the_residual_is_what_a_blend_shape_misses() {
    let (finer, coarser, correspondence) = skinned_levels(8);
    let geomorph = SkinnedGeomorph::new(&finer, &coarser, &correspondence).unwrap();
    let poses = [pose(1), pose(2)];
    let missed = |pose: &Vec<JointMatrix>| {
        let one = |wedge: u32| match correspondence.target(wedge) {
            Target::Point(_) => 0.0,
            Target::Wedge(target) => {
                let at_rest = coarser.positions[coarser.wedge_vertices[target as usize] as usize];
                let wanted = skinned_point(&coarser, target as usize, at_rest, pose);
                skinned_point(&finer, wedge as usize, at_rest, pose).distance(wanted)
            }
        };
        (0..finer.wedge_count() as u32).map(one).fold(0.0, f64::max)
    };
    let known = poses.iter().map(missed).fold(0.0, f64::max);
    let found = geomorph.residual(poses.iter().map(|pose| &**pose)).unwrap();
    assert!(known > 0.1 && (f64::from(found) - known).abs() < 1e-5, "{found} {known}");
    // nothing is missed where nothing but places differ
    let mut moved = finer.clone();
    moved.positions.iter_mut().for_each(|p| p[0] *= 0.5);
    let same = SkinnedGeomorph::new(&finer, &moved, &Correspondence::identity(finer.wedge_count() as u32)).unwrap();
    assert_eq!(same.residual(poses.iter().map(|pose| &**pose)), Ok(0.0));
}
