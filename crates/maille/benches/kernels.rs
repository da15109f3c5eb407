//! The kernels, on a torus and a statue of some ten thousand triangles: small enough to be run often.
//!
//! `cargo bench -p maille`. How whole simplifications compare with those of others: `benches/peers`.

use std::hint::black_box;

use criterion::{BatchSize, BenchmarkId, Criterion, Throughput, criterion_group, criterion_main};
use maille::measure::{Bvh, SurfaceSampler};
use maille::mesh::{WeldOptions, shapes};
use maille::simplify::{MetricKind, PlacementKind, SimplifyOptions, Target, simplify};
use maille::topology::CornerTable;
use maille::{Control, Mesh, samples};

const TRIANGLES: usize = 20_000;
const POINTS: u64 = 10_000;

/// Regular, so that what a kernel does is the same everywhere.
fn torus() -> Mesh {
    shapes::torus(1.0, 0.4, 200, TRIANGLES as u32 / 400)
}

fn elements(count: usize) -> Throughput {
    Throughput::Elements(count as u64)
}

fn bvh(c: &mut Criterion) {
    let (mesh, other) = (samples::statue(TRIANGLES), samples::statue(TRIANGLES / 4));
    let mut group = c.benchmark_group("bvh");
    group.throughput(elements(mesh.triangle_count()));
    group.bench_function("build", |b| b.iter(|| Bvh::new(black_box(&mesh))));

    let tree = Bvh::new(&mesh);
    let near = Bvh::new(&other);
    let sampler = SurfaceSampler::new(&other, near.triangles_in_space_order(), 0);
    let points: Vec<_> = sampler.samples(POINTS, 0..POINTS).map(|sample| sample.point).collect();
    group.throughput(Throughput::Elements(POINTS));
    group.bench_function("closest, in order", |b| {
        b.iter(|| {
            let mut searcher = tree.searcher();
            points.iter().filter_map(|&p| searcher.closest(black_box(p))).map(|found| found.distance_sq).sum::<f64>()
        });
    });
    // far away, many triangles are nearly as near as the nearest
    group.bench_function("closest, far away", |b| {
        b.iter(|| {
            let mut searcher = tree.searcher();
            let far = points.iter().map(|&p| p * 10.0);
            far.filter_map(|p| searcher.closest(black_box(p))).map(|found| found.distance_sq).sum::<f64>()
        });
    });
    group.finish();
}

fn sampling(c: &mut Criterion) {
    let mesh = samples::statue(TRIANGLES);
    let mut group = c.benchmark_group("sample");
    group.throughput(Throughput::Elements(POINTS));
    let sampler = SurfaceSampler::new(&mesh, 0..mesh.triangle_count() as u32, 0);
    group.bench_function("surface", |b| {
        b.iter(|| sampler.samples(POINTS, black_box(0..POINTS)).map(|sample| sample.point).sum::<glam::DVec3>());
    });
    group.finish();
}

fn corner_table(c: &mut Criterion) {
    let mesh = torus();
    let mut group = c.benchmark_group("corner table");
    group.throughput(elements(mesh.triangle_count()));
    group.bench_function("build", |b| b.iter(|| CornerTable::of_vertices(black_box(&mesh))));
    let table = CornerTable::of_vertices(&mesh);
    group.throughput(elements(mesh.vertex_count()));
    group.bench_function("all one-rings", |b| {
        b.iter(|| table.vertices().flat_map(|v| table.vertex_vertices(v)).map(|v| u64::from(v.0)).sum::<u64>());
    });
    group.finish();
}

fn weld(c: &mut Criterion) {
    let mut soup = torus();
    soup.unweld();
    let mut group = c.benchmark_group("weld");
    group.throughput(elements(soup.triangle_count()));
    let tolerant = WeldOptions { tolerance: 1e-6, ..WeldOptions::EXACT };
    for (name, options) in [("exact", WeldOptions::EXACT), ("with a tolerance", tolerant)] {
        group.bench_function(name, |b| {
            b.iter_batched_ref(|| soup.clone(), |mesh| mesh.weld(&options), BatchSize::LargeInput);
        });
    }
    group.finish();
}

/// The cost of a metric, and of its placements: the loop around them is the same.
fn metrics(c: &mut Criterion) {
    let mesh = samples::statue(TRIANGLES);
    let mut group = c.benchmark_group("simplify to 10 %");
    group.throughput(elements(mesh.triangle_count())).sample_size(20);
    let mut bench = |name: &str, metric, placement| {
        let target = Target { triangles: Some(mesh.triangle_count() / 10), max_error: None };
        let options = SimplifyOptions { target, metric, placement, ..SimplifyOptions::default() };
        group.bench_with_input(BenchmarkId::from_parameter(name), &options, |b, options| {
            let run =
                |mesh: &mut Mesh| simplify(mesh, options, Control::default()).expect("a statue can be simplified");
            b.iter_batched_ref(|| mesh.clone(), run, BatchSize::LargeInput);
        });
    };
    for (name, metric) in MetricKind::NAMES {
        bench(name, metric, PlacementKind::default());
    }
    for (name, placement) in PlacementKind::NAMES {
        bench(&format!("qem, {name}"), MetricKind::Quadric, placement);
    }
    group.finish();
}

criterion_group!(kernels, bvh, sampling, corner_table, weld, metrics);
criterion_main!(kernels);
