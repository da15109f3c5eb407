//! Chains of levels of detail, made, written and read again.

use maille::Control;
use maille::mesh::shapes;
use maille::samples::Sample;
use maille_io::{Asset, LodChain, LodOptions, PoseSet, ReadOptions, WriteOptions, lod_chain, order_for_display};
use serde_json::Value;

fn chain(asset: &Asset, options: &LodOptions) -> LodChain {
    lod_chain(asset, options, Control::default()).unwrap_or_else(|error| panic!("{error}"))
}

fn character() -> Asset {
    maille_io::sample(Sample::Character, 4000)
}

/// Writes an asset as .gltf; its JSON, and the asset read again.
fn written(asset: &Asset) -> (Value, Asset) {
    let folder = tempfile::tempdir().expect("a temporary folder can be made");
    let path = folder.path().join("levels.gltf");
    maille_io::write(asset, &path, &WriteOptions::default()).unwrap_or_else(|error| panic!("{error}"));
    let json = serde_json::from_slice(&std::fs::read(&path).expect("it has been written")).expect("it is JSON");
    (json, maille_io::read(&path, &ReadOptions::default()).unwrap_or_else(|error| panic!("{error}")))
}

/// The numbers that an extension of a node lists.
fn levels_of(node: &Value) -> Vec<usize> {
    let ids = node["extensions"]["MSFT_lod"]["ids"].as_array();
    ids.into_iter().flatten().filter_map(Value::as_u64).map(|id| id as usize).collect()
}

#[test]
fn levels_have_the_triangles_asked_for() {
    let asset = character();
    let total = asset.drawn_triangle_count();
    let levels = vec![total / 2, total / 10, 40];
    let chain = chain(&asset, &LodOptions { levels: levels.clone(), ..LodOptions::default() });
    assert_eq!(chain.levels.len(), 3);
    for (level, wanted) in chain.levels.iter().zip(levels) {
        assert!(level.triangles <= wanted && level.triangles + 4 >= wanted, "{} for {wanted}", level.triangles);
        assert_eq!(level.meshes.iter().map(maille::Mesh::triangle_count).sum::<usize>(), level.triangles);
        level.meshes.iter().for_each(|mesh| mesh.check().expect("levels keep the invariants"));
    }
    assert!(chain.levels.is_sorted_by_key(|level| level.error));
    let coverage = chain.screen_coverage();
    assert!(coverage.len() == 4 && coverage.windows(2).all(|pair| pair[0] >= pair[1]) && coverage[0] <= 1.0);
}

#[test]
fn a_chain_is_written_as_nodes_that_share_all_but_the_mesh() {
    let asset = character();
    let levels = vec![1500, 400];
    let options = LodOptions { levels, geomorph: true, ..LodOptions::default() };
    let chain = chain(&asset, &options);
    let (json, again) = written(&asset.with_levels(&chain));
    let nodes = json["nodes"].as_array().expect("there are nodes");
    let listed: Vec<(usize, Vec<usize>)> =
        nodes.iter().map(levels_of).enumerate().filter(|(_, ids)| !ids.is_empty()).collect();
    let [(node, ids)] = &listed[..] else { panic!("one node has levels: {listed:?}") };
    assert_eq!(ids.len(), 2);
    for (k, &id) in ids.iter().enumerate() {
        assert_eq!(nodes[id]["skin"], nodes[*node]["skin"]);
        assert!(nodes[id]["name"].as_str().is_some_and(|name| name.ends_with(&format!("_LOD{}", k + 1))));
        let of_scene = json["scenes"][0]["nodes"].as_array().expect("the scene has nodes");
        assert!(!of_scene.contains(&id.into()), "levels are in no scene");
        let mut children = nodes.iter().filter_map(|node| node["children"].as_array()).flatten();
        assert!(children.all(|child| child.as_u64() != Some(id as u64)), "nor children");
    }
    assert_eq!(nodes[*node]["extras"]["MSFT_screencoverage"].as_array().map(Vec::len), Some(3));
    assert!(json["extensionsUsed"].as_array().is_some_and(|used| used.contains(&"MSFT_lod".into())));
    assert_eq!((again.clips().len(), again.instances.len()), (asset.clips().len(), asset.instances.len()));
    // the original and the first level go on to the next one
    let names: Vec<&str> = json["meshes"]
        .as_array()
        .expect("there are meshes")
        .iter()
        .map(|mesh| mesh["extras"]["targetNames"][0].as_str().unwrap_or(""))
        .collect();
    assert_eq!(names, ["geomorph", "geomorph", ""]);
}

#[test]
fn a_geomorph_target_leads_to_the_next_level() {
    let asset = character();
    let chain = chain(&asset, &LodOptions { levels: vec![1000], geomorph: true, ..LodOptions::default() });
    let (finer, coarser) = (&chain.original[0], &chain.levels[0].meshes[0]);
    let target = finer.morph_targets.last().expect("it has a target");
    let deltas = target.attributes[0].as_f32().expect("deltas are floats");
    // every vertex of the coarser level is where some vertex of the finer one goes, but for the rounding of one addition
    let ends: Vec<glam::Vec3> = (0..finer.wedge_count())
        .map(|w| {
            glam::Vec3::from(finer.positions[finer.wedge_vertices[w] as usize])
                + glam::Vec3::from_slice(&deltas[3 * w..])
        })
        .collect();
    for &p in &coarser.positions {
        let p = glam::Vec3::from(p);
        assert!(ends.iter().any(|end| end.distance(p) < 1e-5), "nothing goes to {p}");
    }
}

#[test]
fn poses_make_levels_move_better() {
    let asset = character();
    let error = |poses: PoseSet| {
        let refit = poses != PoseSet::Bind;
        let chain = chain(&asset, &LodOptions { levels: vec![500], poses, refit, ..LodOptions::default() });
        let level = asset.at_level(&chain.levels[0]);
        let clip = &asset.clips()[0];
        let errors = (0..5).map(|k| {
            let seconds = clip.start() + (clip.end() - clip.start()) * (f64::from(k) + 0.37) / 5.0;
            let [a, b] = [&asset, &level].map(|asset| {
                let instances = asset.animation(0).instances_at(seconds);
                asset.merged_positions_of(&instances)
            });
            let options = maille::measure::CompareOptions { samples: 20_000, ..Default::default() };
            let compared = maille::measure::compare(&a, &b, &options, Control::default()).expect("there are triangles");
            compared.forward.rms.max(compared.backward.rms).powi(2)
        });
        (errors.sum::<f64>() / 5.0).sqrt()
    };
    let [bind, clips] = [PoseSet::Bind, PoseSet::Clips { most: 8 }].map(error);
    assert!(clips < 0.8 * bind, "{clips} with clips, {bind} without");
}

#[test]
fn the_order_for_display_changes_nothing_that_is_drawn() {
    let mut mesh = shapes::sphere(3);
    mesh.triangle_materials = (0..mesh.triangle_count() as u32).map(|t| t % 3).collect();
    let drawn = |mesh: &maille::Mesh| {
        let mut all: Vec<([[u32; 3]; 3], u32)> = (0..mesh.triangle_count())
            .map(|t| {
                let mut corners = mesh.triangle_vertices(t).map(|v| mesh.positions[v as usize].map(f32::to_bits));
                let least = (0..3).min_by_key(|&k| corners[k]).expect("there are three");
                corners.rotate_left(least);
                (corners, mesh.triangle_material(t))
            })
            .collect();
        all.sort_unstable();
        all
    };
    let before = mesh.clone();
    let order = order_for_display(&mut mesh);
    assert_eq!(drawn(&mesh), drawn(&before));
    assert_ne!(mesh.triangles, before.triangles);
    for (new, &old) in order.iter().enumerate() {
        let place = |mesh: &maille::Mesh, w: usize| mesh.positions[mesh.wedge_vertices[w] as usize];
        assert_eq!(place(&mesh, new), place(&before, old as usize));
    }
}
