//! Progressive meshes, written and read again, whole and damaged.

use std::sync::OnceLock;

use maille::mesh::shapes;
use maille::samples::Sample;
use maille::{Attribute, Control, Mesh, Semantic};
use maille_io::{
    Asset, Format, LevelTarget, LodOptions, NamedMesh, PoseSet, ProgressiveAsset, ReadError, ReadOptions, WriteOptions,
    lod_chain, order_for_display, read, read_bytes,
};
use proptest::prelude::*;

/// Where the checksum is in the file, and from where on it counts.
const CHECKSUM: std::ops::Range<usize> = 12..16;
const CHECKED: std::ops::RangeFrom<usize> = 16..;

fn progressive(asset: &Asset) -> ProgressiveAsset {
    let made = ProgressiveAsset::new(asset.clone(), &Default::default(), &PoseSet::Bind, Control::default());
    made.unwrap_or_else(|error| panic!("{error}"))
}

fn bytes_of(progressive: &ProgressiveAsset) -> Vec<u8> {
    let folder = tempfile::tempdir().expect("a temporary folder can be made");
    let path = folder.path().join("a.mpm");
    let written = progressive.write(&path, Control::default()).unwrap_or_else(|error| panic!("{error}"));
    assert_eq!(written.files, std::slice::from_ref(&path));
    std::fs::read(path).expect("it has been written")
}

fn parse(bytes: &[u8]) -> Result<ProgressiveAsset, ReadError> {
    ProgressiveAsset::read_bytes(bytes, &ReadOptions::default())
}

/// A small ball of two materials, one of which the coarsest level loses, and a cube.
fn two_meshes() -> Asset {
    let folder = tempfile::tempdir().expect("a temporary folder can be made");
    let path = folder.path().join("two.glb");
    let mut ball = shapes::sphere(2);
    ball.triangle_materials = (0..128).map(|t| u32::from(t == 77)).collect();
    ball.material_names = vec!["red".into(), "blue".into()];
    let cube = shapes::cube();
    let mut two = Asset::from_mesh("ball", ball);
    two.meshes.push(NamedMesh { name: "cube".into(), mesh: cube });
    two.instances.push(maille_io::Instance { mesh: 1, ..Default::default() });
    maille_io::write(&two, &path, &WriteOptions::default()).unwrap_or_else(|error| panic!("{error}"));
    read(&path, &ReadOptions::default()).unwrap_or_else(|error| panic!("{error}"))
}

fn written_again(asset: &Asset, name: &str) -> Asset {
    let folder = tempfile::tempdir().expect("a temporary folder can be made");
    let path = folder.path().join(name);
    maille_io::write(asset, &path, &WriteOptions::default()).unwrap_or_else(|error| panic!("{error}"));
    read(&path, &ReadOptions::default()).unwrap_or_else(|error| panic!("{error}"))
}

#[test]
fn what_is_written_is_read_with_all_its_levels() {
    let mut annotated = shapes::sphere(3);
    let parts = (0..annotated.triangle_count() as u32).collect();
    annotated.triangle_attributes.push(Attribute::new_u32(Semantic::Custom("part".into()), 1, parts));
    annotated.triangle_materials = (0..512).map(|t| t / 300).collect();
    for asset in [maille_io::sample(Sample::Character, 4000), two_meshes(), Asset::from_mesh("ball", annotated)] {
        let mut original = progressive(&asset);
        let mut again = parse(&bytes_of(&original)).unwrap_or_else(|error| panic!("{error}"));
        assert!(original.meshes().eq(again.meshes()));
        assert_eq!(again.finest().contents(), asset.contents());
        assert_eq!(again.finest().clips(), asset.clips());
        for triangles in [usize::MAX, asset.drawn_triangle_count() / 3, 50, 0] {
            let collapses = original.collapses_for(triangles);
            assert_eq!(again.collapses_for(triangles), collapses);
            assert_eq!(again.error_at(&collapses), original.error_at(&collapses));
            let levels = [&mut original, &mut again].map(|progressive| progressive.level(&collapses));
            let meshes =
                levels.each_ref().map(|asset| asset.meshes.iter().map(|named| &named.mesh).collect::<Vec<_>>());
            assert_eq!(meshes[0], meshes[1]);
            assert_eq!(levels[0].instances.len(), levels[1].instances.len());
            assert_eq!(original.drawn_triangle_count_at(&collapses), levels[0].drawn_triangle_count());
        }
    }
}

#[test]
fn files_of_version_1_stay_readable() {
    let mut old = parse(include_bytes!("data/version-1.mpm")).unwrap_or_else(|error| panic!("{error}"));
    let counts = [usize::MAX, 30, 0].map(|triangles| {
        let collapses = old.collapses_for(triangles);
        old.level(&collapses).triangle_count()
    });
    assert_eq!(counts, [60, 30, 4]);
}

#[test]
fn levels_are_those_of_a_chain() {
    let asset = two_meshes();
    let levels = vec![100, 40];
    let targets = levels.iter().map(|&level| LevelTarget::Triangles(level)).collect();
    let chain = lod_chain(&asset, &LodOptions { levels: targets, ..LodOptions::default() }, Control::default());
    let mut cut = progressive(&asset);
    for (level, triangles) in chain.unwrap_or_else(|error| panic!("{error}")).levels.iter().zip(levels) {
        let collapses = cut.collapses_for(triangles);
        let mut asset = cut.level(&collapses);
        asset.meshes.iter_mut().for_each(|named| drop(order_for_display(&mut named.mesh)));
        assert!(asset.meshes.iter().map(|named| &named.mesh).eq(&level.meshes));
        assert_eq!(cut.error_at(&collapses), level.error);
    }
}

#[test]
fn a_material_that_the_coarsest_level_loses_comes_back() {
    let asset = two_meshes();
    let mut again = parse(&bytes_of(&progressive(&asset))).unwrap_or_else(|error| panic!("{error}"));
    let coarsest = again.collapses_for(0);
    let blue = |mesh: &Mesh| mesh.triangle_materials.iter().filter(|&&slot| slot == 1).count();
    assert_eq!(blue(&again.level(&coarsest).meshes[0].mesh), 0, "the test is about a lost material");
    let finest = written_again(&again.finest(), "finest.glb");
    assert_eq!(blue(&finest.meshes[0].mesh), 1);
    assert_eq!(finest.meshes[0].mesh.material_names, ["red", "blue"]);
    assert_eq!(finest.contents(), asset.contents());
}

#[test]
fn other_readers_see_the_finest_level() {
    let asset = two_meshes();
    let bytes = bytes_of(&progressive(&asset));
    let seen = read_bytes(&bytes, None, &ReadOptions::default()).unwrap_or_else(|error| panic!("{error}"));
    assert_eq!(seen.drawn_triangle_count(), asset.drawn_triangle_count());
    assert_eq!(Format::detect(&bytes, None), Some(Format::Mpm));
}

#[test]
fn an_asset_of_one_level_is_not_written_as_progressive() {
    let folder = tempfile::tempdir().expect("a temporary folder can be made");
    let path = folder.path().join("a.mpm");
    let error = maille_io::write(&two_meshes(), &path, &WriteOptions::default()).expect_err("it has no levels");
    assert!(error.to_string().contains("maille progressive"), "{error}");
    assert_eq!(std::fs::read_dir(folder.path()).expect("it is there").count(), 0, "nothing is left behind");
}

/// A file of two small meshes.
fn small_file() -> &'static [u8] {
    static BYTES: OnceLock<Vec<u8>> = OnceLock::new();
    BYTES.get_or_init(|| bytes_of(&progressive(&two_meshes())))
}

#[test]
fn errors_name_the_place_and_the_remedy() {
    let bytes = small_file();
    let said = |bytes: &[u8]| parse(bytes).expect_err("it is damaged").to_string();
    assert!(said(&bytes[..100]).contains("byte 16: the file has 100 bytes"), "{}", said(&bytes[..100]));
    let changed = |at: usize| {
        let mut bytes = bytes.to_vec();
        bytes[at] ^= 1;
        bytes
    };
    assert!(said(&changed(bytes.len() / 2)).contains("checksum"));
    assert!(said(&changed(8)).contains("version 0 of the format, expected 1 (read it with a newer Maille)"));
    for end in (0..bytes.len()).step_by(7) {
        assert!(said(&bytes[..end]).contains("(the file is damaged"), "cut at {end}");
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(1500))]
    #[test]
    fn mangled_bytes_give_sound_levels_or_an_error(
        changes in prop::collection::vec((0.0..1.0_f64, prop::sample::select(vec![0_u8, 1, 2, 0x7f, 0x80, 0xff]), any::<bool>()), 1..4),
    ) {
        let mut bytes = small_file().to_vec();
        for (place, value, is_added) in changes {
            let at = 16 + (place * (bytes.len() - 16) as f64) as usize;
            bytes[at] = if is_added { bytes[at].wrapping_add(value) } else { value };
        }
        let checksum = crc32fast::hash(&bytes[CHECKED]);
        bytes[CHECKSUM].copy_from_slice(&checksum.to_le_bytes());
        if let Ok(mut read) = parse(&bytes) {
            for triangles in [usize::MAX, 60, 0] {
                let collapses = read.collapses_for(triangles);
                for named in &read.level(&collapses).meshes {
                    prop_assert_eq!(named.mesh.check(), Ok(()));
                }
            }
        }
    }
}
