//! Geomorphs beside a plain copy of as many bytes, in the first caches and beyond the last.
//!
//! `cargo bench -p maille --bench geomorph`. Bytes counted: both ends and the result, of positions and normals: 72 for each
//! wedge that moves. What preparation adds to read (4 for each normal) and what writing makes the machine read are not
//! counted. The copy reads and writes 72 bytes for each wedge together, 36 each.

use std::hint::black_box;
use std::time::{Duration, Instant};

use criterion::{Criterion, Throughput, criterion_group, criterion_main};
use maille::lod::{
    Correspondence, Geomorph, GeomorphOptions, MorphedMesh, NormalInterpolation, Posed, SkinnedGeomorph, joint_matrix,
};
use maille::{Attribute, Mesh, Semantic};

/// Within the first-level cache, the second-level one, the last one (of the machines of our day), and beyond.
const WEDGES: [usize; 4] = [256, 4096, 65_536, 2_097_152];
/// Floats to a cache line.
const LINE: usize = 16;
/// Wedges of the finer level to one of the coarser.
const SHARE: usize = 5;

/// Points on a wavy sheet, normals, and joints and weights of four joints; every `each`th of the wedges of a finer one.
fn level(wedges: usize, each: usize) -> Mesh {
    let at = |i: usize| (i * each) as f32 * 1e-3;
    let positions = (0..wedges).map(|i| [at(i), at(i).sin(), (0.3 * at(i)).cos()]).collect();
    let mut mesh = Mesh::from_triangles(positions, Vec::new()).expect("there are no triangles");
    let normals = (0..wedges).flat_map(|i| glam::Vec3::new(at(i).cos(), 1.0, at(i).sin()).normalize().to_array());
    mesh.set_wedge_attribute(Attribute::new_f32(Semantic::Normal, 3, normals.collect()));
    let joints = (0..wedges).flat_map(|i| [0, 1, 2, 3].map(|k| (i as u32 / 64 + k) % 4));
    mesh.set_wedge_attribute(Attribute::new_u32(Semantic::Joints(0), 4, joints.collect()));
    mesh.set_wedge_attribute(Attribute::new_f32(Semantic::Weights(0), 4, [0.4, 0.3, 0.2, 0.1].repeat(wedges)));
    mesh
}

/// Two levels of which so many in a hundred wedges of the finer one stay where they are.
fn levels(wedges: usize, still_percent: usize) -> (Mesh, Mesh, Correspondence) {
    let (mut finer, coarser) = (level(wedges, 1), level(wedges.div_ceil(SHARE), SHARE));
    let goals = MorphedMesh::new(&coarser);
    let goal_normals = goals.attribute(&Semantic::Normal).and_then(Attribute::as_f32).expect("made by level");
    let (goal_normals, mut normals) = (goal_normals.as_chunks::<3>().0, Vec::with_capacity(3 * wedges));
    for i in 0..wedges {
        let goal = i / SHARE;
        let is_still = (i * 37) % 100 < still_percent;
        let [x, y, z] = goals.positions[goal];
        finer.positions[i] = if is_still { [x, y, z] } else { [x + 0.01 * (1 + i % SHARE) as f32, y, z] };
        let [x, y, z] = goal_normals[goal];
        normals.extend(if is_still { [x, y, z] } else { [y, z, x] });
    }
    finer.set_wedge_attribute(Attribute::new_f32(Semantic::Normal, 3, normals));
    let wedges = (0..wedges as u32).map(|i| i / SHARE as u32).collect();
    (finer, coarser, Correspondence { wedges, vanishing: Vec::new(), coarser_wedges: goals.positions.len() as u32 })
}

fn geomorph(wedges: usize, still_percent: usize, normals: NormalInterpolation) -> (Geomorph, Vec<[f32; 3]>) {
    let (finer, coarser, correspondence) = levels(wedges, still_percent);
    let options = GeomorphOptions { normals, ..GeomorphOptions::default() };
    let geomorph = Geomorph::new(&finer, &coarser, &correspondence, &options).expect("the levels fit");
    (geomorph, MorphedMesh::new(&finer).positions)
}

fn kernels(c: &mut Criterion) {
    for wedges in WEDGES {
        let mut group = c.benchmark_group(format!("geomorph of {wedges} wedges"));
        group.throughput(Throughput::Bytes(72 * wedges as u64)).sample_size(20);
        let (source, mut copy) = (vec![1.0_f32; 9 * wedges + LINE], vec![0.0_f32; 9 * wedges + LINE]);
        let (source, copy) = (aligned(&source), aligned_mut(&mut copy));
        group.bench_function("copy", |b| {
            b.iter(|| black_box(&mut copy[..9 * wedges]).copy_from_slice(black_box(&source[..9 * wedges])));
        });
        let kinds = [
            ("normalised lines", 0, NormalInterpolation::NormalizedLinear),
            ("normalised lines, 5 % stay", 5, NormalInterpolation::NormalizedLinear),
            ("lines", 0, NormalInterpolation::Linear),
            ("arcs", 0, NormalInterpolation::Spherical),
        ];
        for (name, still, normals) in kinds {
            let (geomorph, mut positions) = geomorph(wedges, still, normals);
            let mut normals = positions.clone();
            group.bench_function(name, |b| b.iter(|| morph(&geomorph, &mut positions, &mut normals)));
        }
        group.finish();
    }
}

fn morph(geomorph: &Geomorph, positions: &mut [[f32; 3]], normals: &mut [[f32; 3]]) {
    geomorph.morph_positions(black_box(0.3), black_box(positions));
    geomorph.morph_normals(black_box(0.3), black_box(normals));
}

/// The figures of the book: all in one run, turn about, the fastest turn of each.
#[expect(clippy::print_stdout, reason = "that is what it is for")]
fn figures(_: &mut Criterion) {
    println!("\n   wedges     kind                        copy GB/s  morph GB/s  ratio  million interpolations/s");
    for wedges in WEDGES {
        let (source, mut copy) = (vec![1.0_f32; 9 * wedges + LINE], vec![0.0_f32; 9 * wedges + LINE]);
        let (source, copy) = (aligned(&source), aligned_mut(&mut copy));
        for (name, still, kind) in [
            ("normalised lines", 0, NormalInterpolation::NormalizedLinear),
            ("normalised, 5 % stay", 5, NormalInterpolation::NormalizedLinear),
            ("lines", 0, NormalInterpolation::Linear),
            ("arcs", 0, NormalInterpolation::Spherical),
        ] {
            let (geomorph, mut positions) = geomorph(wedges, still, kind);
            let mut normals = positions.clone();
            let bytes = 36.0 * geomorph.interpolations() as f64;
            let part = bytes as usize / 8;
            let [copying, morphing] = fastest([
                &mut || black_box(&mut copy[..part]).copy_from_slice(black_box(&source[..part])),
                &mut || morph(&geomorph, &mut positions, &mut normals),
            ]);
            let (copying, morphing) = (bytes / copying / 1e9, bytes / morphing / 1e9);
            let ratio = morphing / copying;
            let interpolations = morphing * 1e3 / 36.0;
            println!("{wedges:9}     {name:27} {copying:9.1} {morphing:11.1} {ratio:6.2} {interpolations:14.0}");
        }
    }
    println!(
        "\n   wedges     skinned                     skin both, million/s   morph, million/s   together, million/s"
    );
    for wedges in WEDGES {
        let (finer, coarser, correspondence) = levels(wedges, 5);
        let geomorph = SkinnedGeomorph::new(&finer, &coarser, &correspondence).expect("the levels fit");
        let turned = |i| glam::DMat4::from_rotation_z(0.1 * f64::from(i));
        let pose = [0, 1, 2, 3].map(|i| joint_matrix(&turned(i)));
        let (mut posed, mut targets) = (Posed::default(), Posed::default());
        geomorph.pose(&pose, &mut posed, &mut targets).expect("there are four matrices");
        let (mut moved, goals) = (posed.clone(), targets.clone());
        let [skinning, morphing] = fastest([
            &mut || geomorph.pose(black_box(&pose), &mut posed, &mut targets).expect("there are four matrices"),
            // morphing in place again and again ends at the targets, at the same pace
            &mut || geomorph.morph(black_box(0.3), black_box(&mut moved), black_box(&goals)),
        ]);
        let count = geomorph.interpolations() as f64 / 1e6;
        println!(
            "{wedges:9}     {:27} {:20.1} {:18.1} {:21.1}",
            "positions and normals",
            count / skinning,
            count / morphing,
            count / (skinning + morphing)
        );
    }
}

/// The floats from the first full cache line on: a copy to elsewhere is ten times slower on some machines (Zen 3),
/// which would flatter us.
fn aligned(values: &[f32]) -> &[f32] {
    &values[values.as_ptr().align_offset(4 * LINE)..]
}

fn aligned_mut(values: &mut [f32]) -> &mut [f32] {
    let start = values.as_ptr().align_offset(4 * LINE);
    &mut values[start..]
}

/// Seconds of the fastest turn of each, taken turn about for two seconds.
fn fastest<const N: usize>(mut kernels: [&mut dyn FnMut(); N]) -> [f64; N] {
    let mut best = [f64::INFINITY; N];
    // as many times to a turn that it takes about two milliseconds
    let repeats = kernels.each_mut().map(|kernel| {
        let start = Instant::now();
        let mut count = 0_u32;
        while count == 0 || start.elapsed() < Duration::from_millis(2) {
            kernel();
            count += 1;
        }
        count
    });
    let start = Instant::now();
    while start.elapsed() < Duration::from_secs(2) {
        for ((kernel, best), &repeats) in kernels.iter_mut().zip(&mut best).zip(&repeats) {
            let start = Instant::now();
            (0..repeats).for_each(|_| kernel());
            *best = best.min(start.elapsed().as_secs_f64() / f64::from(repeats));
        }
    }
    best
}

criterion_group!(benches, kernels, figures);
criterion_main!(benches);
