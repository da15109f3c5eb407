//! What writing tells: every file, and everything that the format could not hold.

use std::path::Path;

use maille::mesh::shapes;
use maille::samples::Sample;
use maille::{Attribute, Mesh, Semantic};
use maille_io::{Asset, Instance, NamedMesh, ReadOptions, WriteOptions, Written, read, sample, write};

fn written(asset: &Asset, path: &Path) -> Written {
    write(asset, path, &WriteOptions::default()).unwrap()
}

/// What is said when the asset is written in a format.
fn said(asset: &Asset, extension: &str) -> Vec<String> {
    let folder = tempfile::tempdir().unwrap();
    written(asset, &folder.path().join("a").with_extension(extension)).warnings
}

#[track_caller]
fn assert_says(asset: &Asset, extension: &str, parts: &[&str]) {
    let said = said(asset, extension);
    for part in parts {
        assert!(said.iter().any(|sentence| sentence.contains(part)), "'{part}' is not in {said:?}");
    }
    assert_eq!(said.len(), parts.len(), "{said:?}");
}

#[test]
fn a_bare_mesh_fits_everywhere() {
    for extension in ["glb", "gltf", "ply", "obj", "stl", "off"] {
        assert_says(&Asset::from_mesh("", shapes::tetrahedron()), extension, &[]);
    }
}

#[test]
fn what_only_a_gltf_holds_is_told_kind_by_kind() {
    let character = sample(Sample::Character, 2000);
    assert_says(&character, "gltf", &[]);
    let looks = "the look of 1 material (kept by .glb and .gltf)";
    assert_says(&character, "ply", &[looks, "1 skin", "3 animations"]);
    let attributes = "joints 0, weights 0 (kept by .glb, .gltf and .ply)";
    assert_says(&character, "obj", &[looks, "1 skin", "3 animations", attributes]);
}

#[test]
fn attributes_are_told_by_name_and_many_are_counted() {
    let mut mesh = shapes::tetrahedron();
    let zeros = |components: usize| vec![0.5; 4 * components];
    mesh.set_wedge_attribute(Attribute::new_f32(Semantic::Normal, 3, zeros(3)));
    mesh.set_wedge_attribute(Attribute::new_f32(Semantic::TexCoord(1), 2, zeros(2)));
    for coefficient in 0..9 {
        let semantic = Semantic::Custom(format!("SHcoef_{coefficient}"));
        mesh.vertex_attributes.push(Attribute::new_f32(semantic, 1, zeros(1)));
    }
    mesh.triangle_attributes.push(Attribute::new_u32(Semantic::Custom("label".to_owned()), 1, vec![7; 4]));
    let asset = Asset::from_mesh("", mesh);
    assert_says(&asset, "ply", &[]);
    assert_says(&asset, "glb", &["the attribute label of triangles (kept by .ply)"]);
    assert_says(&asset, "obj", &["uv 1, SHcoef_0, SHcoef_1, SHcoef_2 and 6 more", "label"]);
    assert_says(&asset, "stl", &["normal, uv 1, SHcoef_0, SHcoef_1 and 7 more", "label"]);
}

#[test]
fn meshes_that_become_one_are_told() {
    let named = |mesh: Mesh| NamedMesh { mesh, ..NamedMesh::default() };
    let mut painted = shapes::cube();
    painted.triangle_materials = (0..12).map(|t| t % 2).collect();
    let mut asset = Asset::default();
    asset.meshes = vec![named(painted), named(shapes::tetrahedron()), named(shapes::tetrahedron())];
    asset.instances = [0, 1, 1].map(|mesh| Instance { mesh, ..Instance::default() }).into();
    assert_says(&asset, "glb", &[]);
    let merged = ["1 mesh that the scene does not draw", "the division into 2 meshes at 3 places"];
    assert_says(&asset, "ply", &merged);
    assert_says(&asset, "stl", &[merged[0], merged[1], "the materials of triangles"]);
}

#[test]
fn what_only_an_obj_or_a_ply_holds_is_told() {
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name);
    std::fs::write(path("a.mtl"), "newmtl red\nKd 1 0 0\n map_Kd red.png\nnewmtl blue\n").unwrap();
    std::fs::write(path("a.obj"), "mtllib a.mtl\nv 0 0 0\nv 1 0 0\nv 0 1 0\nusemtl red\nf 1 2 3\n").unwrap();
    let asset = read(&path("a.obj"), &ReadOptions::default()).unwrap();
    assert_says(&asset, "obj", &[]);
    assert_says(&asset, "glb", &["the look of 2 materials with 1 texture (kept by .obj)"]);

    let edges = "ply\nformat ascii 1.0\ncomment TextureFile bark.png\nelement vertex 4\nproperty float x\n\
        property float y\nproperty float z\nelement face 1\nproperty list uchar int vertex_indices\nelement edge 1\n\
        property int vertex1\nproperty int vertex2\nend_header\n0 0 0\n1 0 0\n0 1 0\n5 5 5\n3 0 1 2\n0 1\n";
    std::fs::write(path("a.ply"), edges).unwrap();
    let mut asset = read(&path("a.ply"), &ReadOptions::default()).unwrap();
    assert_says(&asset, "ply", &[]);
    assert_says(&asset, "obj", &["1 texture (kept by .ply)", "1 row of the element 'edge' (kept by .ply)"]);
    asset.meshes[0].mesh.positions.pop();
    asset.meshes[0].mesh.wedge_vertices.pop();
    assert_says(&asset, "ply", &["1 row of the element 'edge', which names vertices by numbers of before"]);
}

#[test]
fn every_file_is_told_the_main_one_first() {
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name);
    let asset = Asset::from_mesh("", shapes::tetrahedron());
    assert_eq!(written(&asset, &path("a.glb")).files, [path("a.glb")]);
    assert_eq!(written(&asset, &path("b.gltf")).files, [path("b.gltf"), path("b.bin")]);
    // the second time, both are replaced
    assert_eq!(written(&asset, &path("b.gltf")).files, [path("b.gltf"), path("b.bin")]);
}

#[test]
fn a_file_beside_the_output_that_is_no_part_of_an_older_one_stays() {
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name);
    std::fs::write(path("a.bin"), "of another model").unwrap();
    let asset = Asset::from_mesh("", shapes::tetrahedron());
    let error = write(&asset, &path("a.gltf"), &WriteOptions::default()).unwrap_err().to_string();
    assert!(error.contains("a.bin") && error.contains("remove it"), "{error}");
    assert_eq!(std::fs::read_to_string(path("a.bin")).unwrap(), "of another model");
    assert!(!path("a.gltf").exists());
}

#[cfg(unix)]
#[test]
fn a_link_stays_a_link() {
    let folder = tempfile::tempdir().unwrap();
    let (file, link) = (folder.path().join("a.ply"), folder.path().join("link.ply"));
    let asset = Asset::from_mesh("", shapes::tetrahedron());
    written(&asset, &file);
    std::os::unix::fs::symlink(&file, &link).unwrap();
    written(&Asset::from_mesh("", shapes::cube()), &link);
    assert!(link.is_symlink());
    assert_eq!(read(&file, &ReadOptions::default()).unwrap().triangle_count(), 12);
}
