//! Binary PLY, in and out, with normals and without: `cargo bench -p maille-io`.

use std::hint::black_box;

use criterion::{Criterion, Throughput, criterion_group, criterion_main};
use maille::Attribute;
use maille::mesh::Semantic;
use maille::samples;
use maille_io::{Asset, Format, ReadOptions, WriteOptions, read_bytes, write};

const TRIANGLES: usize = 50_000;

fn ply(c: &mut Criterion) {
    let plain = samples::statue(TRIANGLES);
    let mut with_normals = plain.clone();
    let up = [0.0, 1.0, 0.0].repeat(plain.wedge_count());
    with_normals.set_wedge_attribute(Attribute::new_f32(Semantic::Normal, 3, up));

    let folder = tempfile::tempdir().expect("a temporary folder can be made");
    let path = folder.path().join("bench.ply");
    let mut group = c.benchmark_group("binary PLY");
    for (name, mesh) in [("positions", plain), ("positions and normals", with_normals)] {
        let asset = Asset::from_mesh(name, mesh);
        let save = || write(&asset, &path, &WriteOptions::default()).expect("a temporary file can be written");
        save();
        let bytes = std::fs::read(&path).expect("it has just been written");
        group.throughput(Throughput::Bytes(bytes.len() as u64));
        group.bench_function(format!("read {name}"), |b| {
            let read = || read_bytes(black_box(&bytes), Some(Format::Ply), &ReadOptions::default());
            b.iter(|| read().expect("it is our own"));
        });
        // with what the system takes for the file itself
        group.bench_function(format!("write {name}"), |b| b.iter(save));
    }
    group.finish();
}

criterion_group!(files, ply);
criterion_main!(files);
