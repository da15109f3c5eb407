//! Chains of levels of detail, made, written and read again.

use maille::Control;
use maille::mesh::shapes;
use maille::samples::Sample;
use maille_io::{
    Asset, AttributeRoles, GeomorphForm, LevelTarget, LodChain, LodOptions, Mask, MaskImage, PoseSet, ReadOptions,
    WriteOptions, lod_chain, order_for_display,
};
use serde_json::Value;

fn chain(asset: &Asset, options: &LodOptions) -> LodChain {
    lod_chain(asset, options, Control::default()).unwrap_or_else(|error| panic!("{error}"))
}

fn character() -> Asset {
    maille_io::sample(Sample::Character, 4000)
}

fn counts(counts: &[usize]) -> Vec<LevelTarget> {
    counts.iter().map(|&count| LevelTarget::Triangles(count)).collect()
}

const MORPHING: GeomorphForm = GeomorphForm { target: true, attributes: false, merge_weights: false };

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
    let chain = chain(&asset, &LodOptions { levels: counts(&levels), ..LodOptions::default() });
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
    let options = LodOptions { levels: counts(&[1500, 400]), geomorph: MORPHING, ..LodOptions::default() };
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
    let chain = chain(&asset, &LodOptions { levels: counts(&[1000]), geomorph: MORPHING, ..LodOptions::default() });
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

/// Root mean square distance between an asset and another one of the same nodes over frames of its first clip.
fn error_over_clip(asset: &Asset, level: &Asset) -> f64 {
    let clip = &asset.clips()[0];
    let errors = (0..5).map(|k| {
        let seconds = clip.start() + (clip.end() - clip.start()) * (f64::from(k) + 0.37) / 5.0;
        let instances = asset.animation(0).instances_at(seconds);
        let [a, b] = [asset, level].map(|asset| asset.merged_positions_of(&instances));
        let options = maille::measure::CompareOptions { samples: 20_000, ..Default::default() };
        let compared = maille::measure::compare(&a, &b, &options, Control::default()).expect("there are triangles");
        compared.forward.rms.max(compared.backward.rms).powi(2)
    });
    (errors.sum::<f64>() / 5.0).sqrt()
}

#[test]
fn poses_make_levels_move_better() {
    let asset = character();
    let error = |poses: PoseSet| {
        let refit = poses != PoseSet::Bind;
        let chain = chain(&asset, &LodOptions { levels: counts(&[500]), poses, refit, ..LodOptions::default() });
        error_over_clip(&asset, &asset.at_level(&chain.levels[0]))
    };
    let [bind, clips] = [PoseSet::Bind, PoseSet::Clips { most: 8 }].map(error);
    assert!(clips < 0.8 * bind, "{clips} with clips, {bind} without");
    // what has never seen the clip does not know how far joints turn, but that they do
    let made_up = error(PoseSet::Extreme { most: 8 });
    assert!(made_up < 0.9 * bind, "{made_up} with poses made up, {bind} without");
}

#[test]
fn the_middle_of_clips_is_a_pose_of_its_own() {
    let asset = character();
    let middle = maille_io::poses_of(&asset, &PoseSet::Middle);
    let rest = maille_io::poses_of(&asset, &PoseSet::Rest);
    assert_eq!([middle[0].len(), rest[0].len()], [1, 1]);
    assert_ne!(middle[0][0].joint_matrices, rest[0][0].joint_matrices);
    let bare = Asset::from_mesh("sphere", shapes::sphere(2));
    for set in [PoseSet::Middle, PoseSet::Extreme { most: 3 }, PoseSet::Clips { most: 3 }] {
        assert_eq!(maille_io::poses_of(&bare, &set), [[]], "{set:?}");
    }
}

#[test]
fn levels_are_chosen_by_error_and_by_size_on_the_screen() {
    let asset = Asset::from_mesh("sphere", shapes::sphere(5));
    let diameter = asset.merged_positions().diagonal();
    let wanted = [0.001 * diameter, 0.01 * diameter];
    let mut levels: Vec<LevelTarget> = wanted.iter().map(|&error| LevelTarget::Error(error)).collect();
    levels.push(LevelTarget::Error(0.01 * diameter)); // no coarser
    // where the model has a hundredth of the height, one of 1080 lines is an eleventh of it
    levels.push(LevelTarget::Screen(0.01));
    let chain = chain(&asset, &LodOptions { levels, ..LodOptions::default() });
    assert_eq!(chain.levels.iter().map(|level| level.target).collect::<Vec<_>>(), [0, 1, 3]);
    for (level, error) in chain.levels.iter().zip([wanted[0], wanted[1], diameter / 10.8]) {
        assert!(level.error <= error && level.error > 0.5 * error, "{} for {error}", level.error);
    }
    let coverage = chain.screen_coverage();
    assert!((0.01..0.02).contains(&coverage[2]), "{coverage:?}");
    let distance = chain.switch_distance(&chain.levels[2], std::f64::consts::FRAC_PI_2);
    assert!((distance - chain.levels[2].error * 540.0).abs() < 1e-6 * distance, "half of the lines to a unit at 1");
}

#[test]
fn a_chain_that_is_read_back_is_what_it_was() {
    let asset = character();
    let form = GeomorphForm { attributes: true, ..MORPHING };
    let chain = chain(&asset, &LodOptions { levels: counts(&[1500, 400]), geomorph: form, ..LodOptions::default() });
    let (_, again) = written(&asset.with_levels(&chain));
    let (whole, levels) = again.split_levels().expect("it has levels").expect("they are understood");
    assert!(whole.split_levels().is_none() && !whole.has_levels());
    assert_eq!((whole.meshes.len(), levels.len()), (asset.meshes.len(), 2));
    assert_eq!((whole.clips(), whole.instances.len()), (asset.clips(), asset.instances.len()));
    for (level, made) in levels.iter().zip(&chain.levels) {
        let level_error = made.error;
        let [read, made] = [&level.meshes[0], &made.meshes[0]];
        assert_eq!((read.triangle_count(), read.wedge_count()), (made.triangle_count(), made.wedge_count()));
        let places = |mesh: &maille::Mesh| -> Vec<[f32; 3]> {
            mesh.triangles.iter().flatten().map(|&w| mesh.positions[mesh.wedge_vertices[w as usize] as usize]).collect()
        };
        assert_eq!(places(read), places(made));
        assert!((level.error / level_error - 1.0).abs() < 1e-3, "{} for {level_error}", level.error);
        assert_eq!(read.wedge_attributes.len(), asset.meshes[0].mesh.wedge_attributes.len(), "no ways to other levels");
    }
    // a level in a file of its own has its way by name, too
    let (json, _) = written(&asset.at_level(&chain.levels[0]));
    assert_eq!(json["meshes"][0]["extras"]["targetNames"], serde_json::json!(["geomorph"]));
    // as if there never had been levels
    let (json, _) = written(&whole);
    let (expected, _) = written(&asset);
    for key in ["nodes", "skins", "scenes", "materials", "extensionsUsed"] {
        assert_eq!(json.get(key), expected.get(key), "{key}");
    }
    // accessors in the middle of their list leave a placeholder of four bytes, shared by all
    let bytes = |json: &Value| json["buffers"][0]["byteLength"].as_u64().expect("there is a buffer");
    assert!(bytes(&json) <= bytes(&expected) + 16, "{} for {}", bytes(&json), bytes(&expected));
    assert!(json["meshes"][0].get("extras").is_none());
}

#[test]
fn a_level_that_was_edited_still_morphs() {
    let asset = character();
    let made = chain(&asset, &LodOptions { levels: counts(&[1500, 400, 100]), ..LodOptions::default() });
    // an artist moves the second level a little, and the tool puts joints into another order
    let mut edited = asset.at_level(&made.levels[1]);
    edited.meshes[0].name += "_LOD2";
    edited.meshes[0].mesh.positions.iter_mut().for_each(|p| p[1] += 0.01);
    let level = asset.level_from(&edited).expect("it is a level of the same asset");
    let levels = made.levels.iter().enumerate().map(|(k, own)| LevelTarget::Meshes {
        meshes: if k == 1 { level.clone() } else { own.meshes.clone() },
        error: None,
    });
    let options = LodOptions { levels: levels.collect(), geomorph: MORPHING, ..LodOptions::default() };
    let again = chain(&asset, &options);
    let places = |mesh: &maille::Mesh| -> Vec<[u32; 3]> {
        let mut places: Vec<[u32; 3]> = mesh.positions.iter().map(|p| p.map(f32::to_bits)).collect();
        places.sort_unstable();
        places
    };
    for (k, (old, new)) in made.levels.iter().zip(&again.levels).enumerate() {
        assert_eq!(old.triangles, new.triangles);
        assert_eq!(places(&old.meshes[0]) == places(&new.meshes[0]), k != 1);
        assert!(new.error > 0.0 && new.correspondences.len() == 1);
    }
    // the level before goes where the edited one is
    let finer = &again.levels[0].meshes[0];
    let deltas = finer.morph_targets[0].attributes[0].as_f32().expect("deltas are floats");
    let edited = &again.levels[1].meshes[0];
    for w in 0..finer.wedge_count() {
        let start = glam::Vec3::from(finer.positions[finer.wedge_vertices[w] as usize]);
        let end = start + glam::Vec3::from_slice(&deltas[3 * w..]);
        assert!(edited.positions.iter().any(|&p| end.distance(p.into()) < 1e-5), "nothing is at {end}");
    }

    let other = Asset::from_mesh("other", shapes::cube());
    let refused = asset.level_from(&other).expect_err("a cube has no joints");
    assert!(refused.contains("joints"), "{refused}");
}

#[test]
fn merged_weights_make_the_morph_target_exact() {
    let asset = character();
    let residuals = |merge_weights| {
        let geomorph = GeomorphForm { merge_weights, ..MORPHING };
        let poses = PoseSet::Clips { most: 4 };
        let options = LodOptions { levels: counts(&[1500, 300]), poses, geomorph, ..LodOptions::default() };
        let chain = chain(&asset, &options);
        chain.levels.iter().map(|level| level.residual.expect("there are geomorphs")).collect::<Vec<f64>>()
    };
    assert!(residuals(false).iter().all(|&residual| residual > 1e-4));
    assert!(residuals(true).iter().all(|&residual| residual < 1e-9));
}

#[test]
fn morph_attributes_hold_what_each_wedge_becomes() {
    let asset = character();
    let geomorph = GeomorphForm { attributes: true, ..GeomorphForm::default() };
    let chain = chain(&asset, &LodOptions { levels: counts(&[600]), geomorph, ..LodOptions::default() });
    let (finer, coarser) = (&chain.original[0], &chain.levels[0].meshes[0]);
    assert!(finer.morph_targets.is_empty());
    let named = |name: &str| {
        let found = finer.wedge_attributes.iter().find(|a| a.semantic.gltf_name() == name);
        found.unwrap_or_else(|| panic!("there is no {name}"))
    };
    let ends = named("_MORPH_POSITION").as_f32().expect("positions are floats");
    let way = &chain.levels[0].correspondences[0];
    for (w, &target) in way.wedges.iter().enumerate().filter(|&(_, &target)| target < way.coarser_wedges) {
        assert_eq!(ends[3 * w..][..3], coarser.positions[coarser.wedge_vertices[target as usize] as usize]);
    }
    for name in ["_MORPH_NORMAL", "_MORPH_JOINTS_0", "_MORPH_WEIGHTS_0"] {
        assert_eq!(named(name).len(), finer.wedge_count());
    }
}

#[test]
fn strips_draw_the_same_triangles() {
    let mut mesh = shapes::sphere(4);
    mesh.triangle_materials =
        mesh.triangles.iter().map(|t| u32::from(mesh.positions[t[0] as usize][0] > 0.0)).collect();
    let asset = Asset::from_mesh("sphere", mesh);
    let folder = tempfile::tempdir().expect("a temporary folder can be made");
    let written = |strips: bool| {
        let path = folder.path().join(format!("{strips}.gltf"));
        let options = WriteOptions { strips, ..WriteOptions::default() };
        maille_io::write(&asset, &path, &options).unwrap_or_else(|error| panic!("{error}"));
        let json: Value = serde_json::from_slice(&std::fs::read(&path).expect("written")).expect("it is JSON");
        let primitives = json["meshes"][0]["primitives"].as_array().expect("there are primitives");
        assert!(primitives.iter().all(|primitive| (primitive["mode"] == 5) == strips));
        let count = |primitive: &Value| {
            let accessor = primitive["indices"].as_u64().expect("it has indices");
            json["accessors"][accessor as usize]["count"].as_u64().expect("it has a count")
        };
        let again = maille_io::read(&path, &ReadOptions::default()).unwrap_or_else(|error| panic!("{error}"));
        (primitives.iter().map(count).sum::<u64>(), drawn(&again.meshes[0].mesh))
    };
    let (list, strip) = (written(false), written(true));
    assert_eq!(list.1, drawn(&asset.meshes[0].mesh));
    assert_eq!(strip.1, list.1);
    assert!(strip.0 * 10 < list.0 * 9, "{} indices in place of {}", strip.0, list.0);
}

#[test]
fn named_levels_stand_beside_the_original() {
    let asset = character();
    let made = chain(&asset, &LodOptions { levels: counts(&[1500, 400]), ..LodOptions::default() });
    let (json, again) = written(&asset.with_named_levels(&made));
    assert_eq!(again.instances.len(), 3 * asset.instances.len());
    assert!(!again.has_levels());
    let drawn = json["nodes"].as_array().into_iter().flatten().filter(|node| node.get("mesh").is_some());
    let names: Vec<&str> = drawn.filter_map(|node| node["name"].as_str()).collect();
    assert_eq!(names.len(), 3);
    for (level, name) in names.iter().enumerate() {
        assert!(name.ends_with(&format!("_LOD{level}")), "{names:?}");
    }
}

#[test]
fn a_painted_region_is_all_that_changes() {
    let mut mesh = shapes::sphere(4);
    let uv = mesh.wedge_vertices.iter().flat_map(|&v| {
        let [x, y, _] = mesh.positions[v as usize];
        [0.5 + 0.4 * x, 0.5 + 0.4 * y]
    });
    let uv: Vec<f32> = uv.collect();
    mesh.wedge_attributes.push(maille::Attribute::new_f32(maille::Semantic::TexCoord(0), 2, uv));
    let asset = Asset::from_mesh("sphere", mesh);
    let right = MaskImage::new(2, vec![0.0, 1.0]).expect("a row of two");
    let mut options = LodOptions { levels: counts(&[1200]), refit: true, ..LodOptions::default() };
    let region = Some(Mask::Image(std::sync::Arc::new(right)));
    options.collapse.roles = AttributeRoles { region, ..AttributeRoles::default() };
    let level = &chain(&asset, &options).levels[0].meshes[0];
    let left = |mesh: &maille::Mesh| -> Vec<[u32; 3]> {
        let left = mesh.positions.iter().filter(|p| p[0] < -1e-3);
        let mut left: Vec<[u32; 3]> = left.map(|p| p.map(f32::to_bits)).collect();
        left.sort_unstable();
        left
    };
    assert_eq!(left(level), left(&asset.meshes[0].mesh));
    assert!(level.triangle_count() <= 1200);
}

/// The triangles of a mesh, by the places of their corners, whichever comes first.
fn drawn(mesh: &maille::Mesh) -> Vec<([[u32; 3]; 3], u32)> {
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
}

#[test]
fn the_order_for_display_changes_nothing_that_is_drawn() {
    let mut mesh = shapes::sphere(3);
    mesh.triangle_materials = (0..mesh.triangle_count() as u32).map(|t| t % 3).collect();
    let before = mesh.clone();
    let order = order_for_display(&mut mesh);
    assert_eq!(drawn(&mesh), drawn(&before));
    assert_ne!(mesh.triangles, before.triangles);
    for (new, &old) in order.iter().enumerate() {
        let place = |mesh: &maille::Mesh, w: usize| mesh.positions[mesh.wedge_vertices[w] as usize];
        assert_eq!(place(&mesh, new), place(&before, old as usize));
    }
}
