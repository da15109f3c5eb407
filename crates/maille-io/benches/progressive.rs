//! Progressive meshes: vertex splits and edge collapses a second on one core, collapses saved and loaded a second (in memory,
//! from the base and to it), bytes to a collapse.
//!
//! `cargo bench -p maille-io --bench progressive`. Samples from within the second-level cache to beyond the last one, bare and
//! with attributes; and, where `MAILLE_MODELS` names a folder of models, `textured/FlightHelmet.glb`, the mesh of it that has
//! the most triangles.

use std::hint::black_box;
use std::path::PathBuf;
use std::time::{Duration, Instant};

use criterion::{BenchmarkId, Criterion, Throughput, criterion_group, criterion_main};
use maille::progressive::ProgressiveMesh;
use maille::{Control, Mesh, samples};
use maille_io::ReadOptions;

const TRIANGLES: [usize; 3] = [10_000, 100_000, 1_000_000];

fn without_attributes(mut mesh: Mesh) -> Mesh {
    mesh.wedge_attributes.clear();
    mesh.vertex_attributes.clear();
    mesh
}

/// What is measured, each with its name; the largest last.
fn meshes() -> impl Iterator<Item = (String, Mesh)> {
    let pair =
        |name: &str, mesh: Mesh| [(format!("{name}, bare"), without_attributes(mesh.clone())), (name.to_owned(), mesh)];
    let helmet = helmet().into_iter().flat_map(move |mesh| pair("FlightHelmet", mesh));
    let terrains = TRIANGLES.into_iter();
    helmet.chain(terrains.flat_map(move |n| pair(&format!("terrain of {n}"), samples::terrain(n))))
}

#[expect(clippy::print_stdout, reason = "a bench that says what it leaves out")]
fn helmet() -> Option<Mesh> {
    let folder = std::env::var_os("MAILLE_MODELS").map(PathBuf::from);
    let path = folder.map(|folder| folder.join("textured/FlightHelmet.glb")).filter(|path| path.exists());
    let Some(path) = path else {
        println!("left out: FlightHelmet (MAILLE_MODELS is not set to a folder that has it)");
        return None;
    };
    let asset = maille_io::read(&path, &ReadOptions::default()).unwrap_or_else(|error| panic!("{error}"));
    asset.meshes.into_iter().map(|named| named.mesh).max_by_key(Mesh::triangle_count)
}

/// Time of so many turns, if all were as fast as the fastest: others may have had the core for a while.
fn fastest(times: u64, turn: impl FnMut() -> Duration) -> Duration {
    let best = std::iter::repeat_with(turn).take(times as usize).min().unwrap_or_default();
    best * u32::try_from(times).unwrap_or(u32::MAX)
}

fn time_of<T>(work: impl FnOnce() -> T) -> Duration {
    let start = Instant::now();
    black_box(work());
    start.elapsed()
}

#[expect(clippy::print_stdout, reason = "the size is a figure, too")]
fn progressive(c: &mut Criterion) {
    let mut group = c.benchmark_group("progressive");
    group.sample_size(10).warm_up_time(Duration::from_millis(500)).measurement_time(Duration::from_secs(2));
    for (name, mesh) in meshes() {
        let made = ProgressiveMesh::new(mesh, &Default::default(), Control::default());
        let (mut mesh, _) = made.unwrap_or_else(|error| panic!("{name}: {error}"));
        let count = mesh.collapse_count();
        let each = mesh.log_bytes() as f64 / count as f64;
        println!("{name}: {} triangles, {count} collapses, {each:.1} bytes to each", mesh.counts_at(0).triangles);
        group.throughput(Throughput::Elements(count as u64));
        for (what, from, to) in [("splits", count, 0), ("collapses", 0, count)] {
            let mut turn = || {
                mesh.seek(from);
                time_of(|| mesh.seek(to))
            };
            group.bench_function(BenchmarkId::new(what, &name), |b| b.iter_custom(|times| fastest(times, &mut turn)));
        }
        mesh.seek(count);
        let bytes = mesh.to_bytes();
        let save = || time_of(|| mesh.to_bytes());
        let load = || time_of(|| ProgressiveMesh::from_bytes(&bytes));
        group.bench_function(BenchmarkId::new("save", &name), |b| b.iter_custom(|times| fastest(times, save)));
        group.bench_function(BenchmarkId::new("load", &name), |b| b.iter_custom(|times| fastest(times, load)));
    }
    group.finish();
}

criterion_group!(benches, progressive);
criterion_main!(benches);
