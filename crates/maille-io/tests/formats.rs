//! What PLY, OBJ, STL and OFF promise: what is written is read back, and damage gives errors.

use std::path::Path;
use std::sync::atomic::AtomicBool;

use maille::mesh::{ComponentType, Storage, Values, shapes};
use maille::{Attribute, Control, Mesh, Semantic};
use maille_io::{Asset, Format, ReadError, ReadOptions, WriteOptions, read, read_bytes, write, write_with};
use proptest::prelude::*;

const BINARY: WriteOptions = WriteOptions { text: false, binary_off: true, strips: false };
const TEXT: WriteOptions = WriteOptions { text: true, binary_off: false, strips: false };

/// The bytes of an asset in the format that the name tells.
fn bytes_of(asset: &Asset, name: &str, options: &WriteOptions) -> Vec<u8> {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join(name);
    write(asset, &path, options).unwrap();
    std::fs::read(path).unwrap()
}

fn parse(bytes: &[u8]) -> Result<Asset, ReadError> {
    read_bytes(bytes, None, &ReadOptions::default())
}

fn mesh_of(bytes: &[u8]) -> Mesh {
    let mut asset = parse(bytes).unwrap();
    asset.meshes.swap_remove(0).mesh
}

fn written_and_read(mesh: &Mesh, name: &str, options: &WriteOptions) -> Mesh {
    mesh_of(&bytes_of(&Asset::from_mesh("", mesh.clone()), name, options))
}

/// For every corner of every triangle: its position, then its values of an attribute.
fn corner_values(mesh: &Mesh, semantic: Option<&Semantic>) -> Vec<f32> {
    let corners = mesh.triangles.iter().flatten().map(|&w| w as usize);
    match semantic {
        None => corners.flat_map(|w| mesh.positions[mesh.wedge_vertices[w] as usize]).collect(),
        Some(semantic) => {
            let attribute = mesh.wedge_attribute(semantic).unwrap_or_else(|| panic!("{semantic} is lost"));
            let values = attribute.as_f32().unwrap();
            corners.flat_map(|w| &values[w * attribute.components..][..attribute.components]).copied().collect()
        }
    }
}

fn byte_colors(values: Vec<u8>) -> Attribute {
    Attribute {
        semantic: Semantic::Color(0),
        components: 3,
        values: Values::F32(values.into_iter().map(|v| f32::from(v) / 255.0).collect()),
        storage: Storage { component: ComponentType::U8, normalized: true, srgb: true },
    }
}

/// Meshes with seams, unused vertices and degenerate triangles, and every attribute that the formats know.
fn meshes() -> impl Strategy<Value = Mesh> {
    (1..12_usize, 1..20_usize, 1..15_usize).prop_flat_map(|(vertices, wedges, triangles)| {
        let number = || prop_oneof![-10.0_f32..10.0, Just(0.0), Just(1e-20), Just(-3e20)];
        let floats = move |count| prop::collection::vec(number(), count);
        let wedge = 0..wedges as u32;
        (
            prop::collection::vec([number(), number(), number()], vertices),
            prop::collection::vec(0..vertices as u32, wedges),
            prop::collection::vec([wedge.clone(), wedge.clone(), wedge], triangles),
            (floats(3 * wedges), floats(2 * wedges), floats(wedges)),
            prop::collection::vec(any::<u8>(), 3 * wedges),
            prop::collection::vec(0..3_u32, triangles),
        )
            .prop_map(|(positions, wedge_vertices, triangles, (normals, uvs, custom), colors, materials)| {
                Mesh {
                    positions,
                    wedge_vertices,
                    triangles,
                    wedge_attributes: vec![
                        Attribute::new_f32(Semantic::Normal, 3, normals),
                        Attribute::new_f32(Semantic::TexCoord(0), 2, uvs),
                        byte_colors(colors),
                        Attribute::new_f32(Semantic::Custom("quality".into()), 1, custom),
                    ],
                    triangle_materials: materials,
                    ..Mesh::default()
                }
            })
    })
}

proptest! {
    #[test]
    fn ply_brings_back_every_corner(mesh in meshes(), text in any::<bool>()) {
        let back = written_and_read(&mesh, "a.ply", &WriteOptions { text, ..WriteOptions::default() });
        prop_assert_eq!(corner_values(&back, None), corner_values(&mesh, None));
        for attribute in &mesh.wedge_attributes {
            let semantic = Some(&attribute.semantic);
            prop_assert_eq!(corner_values(&back, semantic), corner_values(&mesh, semantic));
        }
        // slots may be renumbered, but tell the same triangles apart
        for t in 0..mesh.triangle_count() {
            let (a, b) = ((back.triangle_material(t), back.triangle_material(0)), (mesh.triangle_material(t), mesh.triangle_material(0)));
            prop_assert_eq!(a.0 == a.1, b.0 == b.1);
        }
    }

    #[test]
    fn obj_brings_back_every_corner_and_material(mut mesh in meshes()) {
        mesh.material_names = ["red", "green", "a blue one"].map(String::from).into();
        // an OBJ has one colour for each vertex, and normals of length 0 mean none
        mesh.wedge_attributes.retain(|a| a.semantic != Semantic::Color(0));
        let back = written_and_read(&mesh, "a.obj", &TEXT);
        prop_assert_eq!(&back.positions, &mesh.positions);
        prop_assert_eq!(corner_values(&back, None), corner_values(&mesh, None));
        prop_assert_eq!(corner_values(&back, Some(&Semantic::TexCoord(0))), corner_values(&mesh, Some(&Semantic::TexCoord(0))));
        if back.wedge_attribute(&Semantic::Normal).is_some() {
            prop_assert_eq!(corner_values(&back, Some(&Semantic::Normal)), corner_values(&mesh, Some(&Semantic::Normal)));
        }
        for t in 0..mesh.triangle_count() {
            let name = |m: &Mesh| m.material_names[m.triangle_material(t) as usize].clone();
            prop_assert_eq!(name(&back), name(&mesh));
        }
    }

    #[test]
    fn off_brings_back_every_corner(mesh in meshes(), binary_off in any::<bool>()) {
        let back = written_and_read(&mesh, "a.off", &WriteOptions { binary_off, ..WriteOptions::default() });
        prop_assert_eq!(corner_values(&back, None), corner_values(&mesh, None));
        for semantic in [Semantic::Normal, Semantic::TexCoord(0)] {
            prop_assert_eq!(corner_values(&back, Some(&semantic)), corner_values(&mesh, Some(&semantic)));
        }
        let bytes = |m: &Mesh| -> Vec<u8> {
            let components = m.wedge_attribute(&Semantic::Color(0)).unwrap().components;
            let values = corner_values(m, Some(&Semantic::Color(0)));
            values.chunks(components).flat_map(|c| c[..3].iter().map(|v| (v * 255.0).round() as u8).collect::<Vec<_>>()).collect()
        };
        // bytes of 0 and 1 alone look like floats
        if bytes(&mesh).iter().any(|&b| b > 1) || binary_off {
            prop_assert_eq!(bytes(&back), bytes(&mesh));
        }
    }

    #[test]
    fn stl_brings_back_every_corner_position(mesh in meshes(), text in any::<bool>()) {
        let back = written_and_read(&mesh, "a.stl", &WriteOptions { text, ..WriteOptions::default() });
        prop_assert_eq!(corner_values(&back, None), corner_values(&mesh, None));
    }

    #[test]
    fn any_bytes_behind_a_keyword_give_a_mesh_or_an_error(
        start in prop::sample::select(vec!["ply\nformat ascii 1.0\n", "OFF\n", "solid\n", "v 0 0 0\n", "OFF BINARY\n", ""]),
        rest in prop_oneof![prop::collection::vec(any::<u8>(), 0..300), "[a-z0-9 .\\-/\n]{0,300}".prop_map(String::into_bytes)],
    ) {
        if let Ok(asset) = parse(&[start.as_bytes(), &rest].concat()) {
            prop_assert_eq!(asset.meshes[0].mesh.check(), Ok(()));
        }
    }
}

/// Small valid files of every format and form.
fn small_files() -> Vec<(&'static str, Vec<u8>)> {
    let mut mesh = shapes::tetrahedron();
    mesh.set_wedge_attribute(Attribute::new_f32(Semantic::Normal, 3, [0.5; 12].to_vec()));
    mesh.set_wedge_attribute(byte_colors((0..12).collect()));
    let asset = Asset::from_mesh("", mesh);
    let mut files: Vec<_> = ["a.ply", "a.stl", "a.off"].map(|name| (name, bytes_of(&asset, name, &BINARY))).into();
    files.extend(["a.ply", "a.stl", "a.off", "a.obj"].map(|name| (name, bytes_of(&asset, name, &TEXT))));
    files.push(("a.ply", BIG_ENDIAN_WITH_EVERYTHING()));
    files
}

/// A quad, a triangle with texture coordinates, a strip's worth of other elements, in big endian.
#[expect(non_snake_case, reason = "a constant but for its allocation")]
fn BIG_ENDIAN_WITH_EVERYTHING() -> Vec<u8> {
    let header = "ply\nformat binary_big_endian 1.0\ncomment by hand\nobj_info two lines\ncomment TextureFile a.png\n\
        element vertex 5\nproperty double x\nproperty double y\nproperty double z\nproperty short quality\n\
        property list uchar short neighbours\nelement face 2\nproperty uchar red\nproperty uchar green\nproperty uchar blue\n\
        property list uchar uint vertex_index\nproperty list uchar float texcoord\nproperty int texnumber\n\
        element edge 1\nproperty int vertex1\nproperty int vertex2\nelement thing 2\nproperty list ushort double data\n\
        end_header\n";
    let mut bytes = header.as_bytes().to_vec();
    for (i, [x, y]) in [[0.0_f64, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0], [2.0, 0.5]].into_iter().enumerate() {
        [x, y, 0.0].iter().for_each(|v| bytes.extend(v.to_be_bytes()));
        bytes.extend((i as i16 - 2).to_be_bytes());
        bytes.extend([1, 0, 7]);
    }
    let mut face = |indices: &[u32], number: i32| {
        bytes.extend([10, 20, 30, indices.len() as u8]);
        indices.iter().for_each(|i| bytes.extend(i.to_be_bytes()));
        bytes.push(2 * indices.len() as u8);
        indices.iter().for_each(|&i| [i as f32, number as f32].iter().for_each(|v| bytes.extend(v.to_be_bytes())));
        bytes.extend(number.to_be_bytes());
    };
    face(&[0, 1, 2, 3], 0);
    face(&[1, 4, 2], 5);
    [0_i32, 4].iter().for_each(|i| bytes.extend(i.to_be_bytes()));
    bytes.extend(2_u16.to_be_bytes());
    [0.5_f64, 1e300].iter().for_each(|v| bytes.extend(v.to_be_bytes()));
    bytes.extend(0_u16.to_be_bytes());
    bytes
}

#[test]
fn ply_keeps_wedges_notes_and_what_it_does_not_know() {
    let source = parse(&BIG_ENDIAN_WITH_EVERYTHING()).unwrap();
    let mesh = &source.meshes[0].mesh;
    assert_eq!((mesh.triangle_count(), mesh.vertex_count(), mesh.wedge_count()), (3, 5, 7));
    let quality = mesh.wedge_attribute(&Semantic::Custom("quality".into())).unwrap();
    assert_eq!(quality.as_f32().unwrap()[..4], [-2.0, -1.0, 0.0, 1.0]);
    assert_eq!(mesh.triangle_materials, [0, 0, 1]);
    assert_eq!(mesh.material_names, ["a.png", ""]);
    assert_eq!(mesh.triangle_attributes[0].as_f32().unwrap()[0], 10.0 / 255.0);

    for options in [BINARY, TEXT] {
        let bytes = bytes_of(&source, "a.ply", &options);
        let header = String::from_utf8_lossy(&bytes).into_owned();
        for line in [
            "comment by hand\nobj_info two lines\n",
            "property double x\n",
            "property short quality\n",
            "element vertex 5\n",
            "property list uchar float texcoord\n",
            "property int texnumber\n",
            "element edge 1\n",
            "element thing 2\nproperty list ushort double data\n",
            "property list uchar uint vertex_index\n",
        ] {
            assert!(header.contains(line), "{line} is lost in\n{header}");
        }
        let back = parse(&bytes).unwrap();
        let again = &back.meshes[0].mesh;
        assert_eq!(corner_values(again, None), corner_values(mesh, None));
        let uv = Some(&Semantic::TexCoord(0));
        assert_eq!(corner_values(again, uv), corner_values(mesh, uv));
        assert_eq!(again.triangle_materials, mesh.triangle_materials);
        assert_eq!(bytes_of(&back, "b.ply", &options), bytes);
    }
}

#[test]
fn ply_rows_along_a_seam_are_wedges_of_one_vertex() {
    let text = "ply\nformat ascii 1.0\nelement vertex 6\nproperty float x\nproperty float y\nproperty float z\n\
        property float s\nproperty float t\nelement face 2\nproperty list uchar int vertex_indices\nend_header\n\
        0 0 0 0 0\n1 0 0 1 0\n1 1 0 1 1\n0 0 0 0.5 0\n1 1 0 0.5 1\n0 1 0 0 1\n3 0 1 2\n3 3 4 5\n";
    let asset = parse(text.as_bytes()).unwrap();
    let mesh = &asset.meshes[0].mesh;
    assert_eq!((mesh.vertex_count(), mesh.wedge_count()), (4, 6));
    assert_eq!(bytes_of(&asset, "a.ply", &TEXT), text.as_bytes());
    let plain = text.replace("property float s\nproperty float t\n", "property float a\nproperty float b\n");
    assert_eq!(mesh_of(plain.as_bytes()).vertex_count(), 6);
}

#[test]
fn text_ply_tells_what_is_in_the_other_elements() {
    let bytes = bytes_of(&parse(&BIG_ENDIAN_WITH_EVERYTHING()).unwrap(), "a.ply", &TEXT);
    assert!(String::from_utf8(bytes).unwrap().ends_with("\n0 4\n2 0.5 1e300\n0\n"));
}

#[test]
fn every_prefix_is_an_error_or_a_sound_mesh() {
    for (name, bytes) in small_files() {
        for length in 0..bytes.len() {
            for hint in [None, Format::from_path(Path::new(name))] {
                if let Ok(asset) = read_bytes(&bytes[..length], hint, &ReadOptions::default()) {
                    assert_eq!(asset.meshes[0].mesh.check(), Ok(()), "{name} cut after {length} bytes");
                    assert!(asset.triangle_count() > 0);
                }
            }
        }
        parse(&bytes).unwrap();
    }
}

#[test]
fn every_flipped_byte_is_an_error_or_a_sound_mesh() {
    for (name, bytes) in small_files() {
        for at in 0..bytes.len() {
            for flip in [1, 0x20, 0x80, 0xff] {
                let mut bytes = bytes.clone();
                bytes[at] ^= flip;
                if let Ok(asset) = parse(&bytes) {
                    assert_eq!(asset.meshes[0].mesh.check(), Ok(()), "{name}, byte {at} ^ {flip}");
                }
            }
        }
    }
}

#[test]
fn counts_that_the_file_cannot_hold_are_refused_before_anything_is_allocated() {
    let ply = |vertices: u64, faces: u64, body: &[u8]| {
        let header = format!(
            "ply\nformat binary_little_endian 1.0\nelement vertex {vertices}\nproperty float x\nproperty float y\n\
             property float z\nelement face {faces}\nproperty list uchar int vertex_indices\nend_header\n"
        );
        [header.as_bytes(), body].concat()
    };
    let negative = [&[0; 36][..], &[3, 0, 0, 0, 0, 1, 0, 0, 0, 255, 255, 255, 255]].concat();
    let mut stl = vec![0; 84 + 50];
    stl[80..84].copy_from_slice(&u32::MAX.to_le_bytes());
    let text = |text: &str| text.as_bytes().to_vec();
    let files = [
        (ply((1 << 32) - 2, 1, &[]), Format::Ply),
        (ply(u64::MAX, u64::MAX, &[0; 9]), Format::Ply),
        (ply(3, 1 << 40, &[0; 36]), Format::Ply),
        (ply(3, 1, &negative), Format::Ply),
        (text("ply\nformat ascii 1.0\nelement thing 999999999999\nend_header\n"), Format::Ply),
        (
            text("ply\nformat ascii 1.0\nelement thing 9\nproperty list int int x\nend_header\n2000000000 1"),
            Format::Ply,
        ),
        (stl, Format::Stl),
        (text("OFF\n1000000000 1000000000 0\n0 0 0\n"), Format::Off),
        (text("OFF\n3 1 0\n0 0 0 1 0 0 0 1 0\n4000000000 0 1 2\n"), Format::Off),
        ([&b"OFF BINARY\n"[..], &[127; 40]].concat(), Format::Off),
        (text("v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 4\n"), Format::Obj),
        (text("v 0 0 0\nv 1 0 0\nv 0 1 0\nf -1 -2 -4\n"), Format::Obj),
        (text("v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 99999999999999999999\n"), Format::Obj),
        (text("v 0 0 0\nv 1 0 0\nv 0 1 0\nf 0 1 2\n"), Format::Obj),
    ];
    for (i, (bytes, format)) in files.into_iter().enumerate() {
        let error = read_bytes(&bytes, Some(format), &ReadOptions::default()).unwrap_err().to_string();
        assert!(!error.contains("no triangles"), "file {i}: {error}");
    }
}

#[test]
fn files_without_triangles_say_so() {
    let files = [
        "solid a\nendsolid a\n",
        "OFF\n3 0 0\n0 0 0\n1 0 0\n0 1 0\n",
        "v 0 0 0\nv 1 0 0\np 1\n",
        "ply\nformat ascii 1.0\nelement vertex 1\nproperty float x\nproperty float y\nproperty float z\nend_header\n0 0 0\n",
    ];
    for file in files {
        let error = parse(file.as_bytes()).unwrap_err().to_string();
        assert!(error.contains("holds no triangles"), "{error}");
    }
    assert!(parse(b"").unwrap_err().to_string().contains("empty"));
}

#[test]
fn errors_name_the_file_the_line_and_a_remedy() {
    let folder = tempfile::tempdir().unwrap();
    let message = |name: &str, text: &str| {
        let path = folder.path().join(name);
        std::fs::write(&path, text).unwrap();
        read(&path, &ReadOptions::default()).unwrap_err().to_string()
    };
    let obj = message("a.obj", "v 0 0 0\nv 1 0 0\r\nv 0 1 0\n\nf 1 2 3\nf 1 2 9\n");
    assert!(obj.contains("a.obj") && obj.contains("line 6") && obj.contains("vertex 9"), "{obj}");
    let off = message("a.off", "OFF\n3 1 0\n0 0 0\n1 0 zero\n0 1 0\n3 0 1 2\n");
    assert!(off.contains("line 4") && off.contains("'zero'"), "{off}");
    let stl = message("a.stl", "solid\nfacet normal 0 0 1\nouter loop\nvertex 0 0\n\nendloop\n");
    assert!(stl.contains("line 6"), "{stl}");
    let ply = message("a.ply", "ply\nformat ascii 1.0\nelement vertex 1\nproperty real x\nend_header\n");
    assert!(ply.contains("line 4") && ply.contains("'real'"), "{ply}");
    let absent = read(&folder.path().join("absent.ply"), &ReadOptions::default()).unwrap_err().to_string();
    assert!(absent.contains("absent.ply"), "{absent}");
    let empty = message("empty.stl", "");
    for error in [obj, off, stl, ply, absent, empty] {
        assert!(error.contains(" (") && error.ends_with(')'), "no remedy: {error}");
    }
}

#[test]
fn obj_understands_what_programs_write() {
    let text = "# comment\nmtllib none.mtl\no first\nv 0 0 0 # corner\nv 1 0 0\\\n\nv 1 1 0\nv 0 1 0 1.0\nvt 0 0\nvt 1 0 0\n\
        vn 0 0 1\ng left wing\nusemtl red paint\ns 3\nf 1/1/1 2/2/1 3//1 -1\no second\ns off\nusemtl blue\nf 1 2 \\\n 3\nl 1 2\n";
    let asset = parse(text.as_bytes()).unwrap();
    let mesh = &asset.meshes[0].mesh;
    assert_eq!((mesh.triangle_count(), mesh.vertex_count()), (3, 4));
    assert_eq!(mesh.material_names, ["red paint", "blue"]);
    assert_eq!(mesh.triangle_materials, [0, 0, 1]);
    let label = |name: &str| {
        let found = mesh.triangle_attributes.iter().find(|a| a.semantic == Semantic::Custom(name.into()));
        found.unwrap().as_u32().unwrap().to_vec()
    };
    assert_eq!((label("group"), label("smoothing")), (vec![0, 0, 1], vec![3, 3, 0]));
    assert!(asset.warnings.iter().any(|w| w.contains("1 lines")), "{:?}", asset.warnings);
    let written = String::from_utf8(bytes_of(&asset, "a.obj", &TEXT)).unwrap();
    for line in ["o first\ng left wing\nusemtl red paint\ns 3\nf 1/1/1 2/2/1 ", "o second\nusemtl blue\ns 0\nf "] {
        assert!(written.contains(line), "{line} is lost in\n{written}");
    }
}

#[test]
fn obj_vertex_colors_stay_with_their_vertices() {
    let text = "v 0 0 0 0.25 0.5 1\nv 1 0 0 0 0 0\nv 0 1 0 1 1 1\nf 1 2 3\n";
    let mesh = mesh_of(text.as_bytes());
    let colors = corner_values(&mesh, Some(&Semantic::Color(0)));
    assert_eq!(colors[..6], [0.25, 0.5, 1.0, 0.0, 0.0, 0.0]);
    assert_eq!(mesh_of(&bytes_of(&Asset::from_mesh("", mesh.clone()), "a.obj", &TEXT)), mesh);
}

#[test]
fn the_mtl_is_written_beside_the_obj() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.obj");
    std::fs::write(folder.path().join("some.mtl"), "newmtl red\nKd 1 0 0").unwrap();
    std::fs::write(&path, "mtllib some.mtl\nv 0 0 0\nv 1 0 0\nv 0 1 0\nusemtl red\nf 1 2 3\n").unwrap();
    let asset = read(&path, &ReadOptions::default()).unwrap();
    assert_eq!(asset.warnings, [""; 0]);
    let target = folder.path().join("b.obj");
    write(&asset, &target, &TEXT).unwrap();
    assert!(std::fs::read_to_string(&target).unwrap().starts_with("mtllib b.mtl\n"));
    assert_eq!(std::fs::read_to_string(folder.path().join("b.mtl")).unwrap(), "newmtl red\nKd 1 0 0\n");
}

#[test]
fn an_mtl_elsewhere_is_not_read() {
    let folder = tempfile::tempdir().unwrap();
    std::fs::create_dir(folder.path().join("inner")).unwrap();
    std::fs::write(folder.path().join("secret"), "private").unwrap();
    let path = folder.path().join("inner/a.obj");
    std::fs::write(&path, "mtllib ../secret\nv 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n").unwrap();
    let asset = read(&path, &ReadOptions::default()).unwrap();
    assert_eq!(asset.warnings.len(), 1);
    write(&asset, &folder.path().join("b.obj"), &TEXT).unwrap();
    assert!(!folder.path().join("b.mtl").exists());
}

#[test]
fn off_reads_all_its_family() {
    let triangle = "0 0 0 {}\n1 0 0 {}\n0 1 0 {}\n";
    let file = |keyword: &str, more: &str| format!("{keyword}{}3 0 1 2\n", triangle.replace("{}", more));
    let colors = |mesh: &Mesh| mesh.wedge_attribute(&Semantic::Color(0)).unwrap().clone();
    let floats = mesh_of(file("COFF\n3 1 0\n", "0.5 0.25 1 1").as_bytes());
    assert_eq!(colors(&floats).as_f32().unwrap()[..4], [0.5, 0.25, 1.0, 1.0]);
    let bytes = mesh_of(file("# comment\nCNOFF 3 1\n", "0 0 1 255 0 51").as_bytes());
    assert_eq!(colors(&bytes).as_f32().unwrap()[..3], [1.0, 0.0, 0.2]);
    assert_eq!(bytes.wedge_attribute(&Semantic::Normal).unwrap().as_f32().unwrap()[..3], [0.0, 0.0, 1.0]);
    let uvs = mesh_of(file("STOFF\n3 1 0\n", "0.5 0.75").as_bytes());
    assert_eq!(corner_values(&uvs, Some(&Semantic::TexCoord(0)))[..2], [0.5, 0.75]);
    let faces = mesh_of(b"OFF\n4 2 0\n0 0 0\n1 0 0\n1 1 0\n0 1 0\n3 0 1 2 7\n4 0 1 2 3 255 0 0\n");
    assert_eq!(faces.triangle_attributes[0].as_f32().unwrap(), [1., 1., 1., 1., 0., 0., 1., 0., 0.]);
    let error = parse(file("4OFF\n3 1 0\n", "1").as_bytes()).unwrap_err().to_string();
    assert!(error.contains("three dimensions"), "{error}");
}

#[test]
fn stl_joins_corners_and_keeps_colors() {
    let mut mesh = shapes::cube();
    let colors: Vec<f32> = (0..36).map(|i| (i % 32) as f32 / 31.0).collect();
    let storage = Storage { component: ComponentType::U8, normalized: true, srgb: true };
    mesh.triangle_attributes.push(Attribute {
        semantic: Semantic::Color(0),
        components: 3,
        values: Values::F32(colors),
        storage,
    });
    let back = written_and_read(&mesh, "a.stl", &BINARY);
    assert_eq!((back.vertex_count(), back.wedge_count()), (8, 8));
    assert_eq!(back.triangle_attributes, mesh.triangle_attributes);
    assert_eq!(written_and_read(&mesh, "a.stl", &TEXT).vertex_count(), 8);
}

#[test]
fn far_coordinates_warn_of_what_they_lose() {
    let text = "ply\nformat ascii 1.0\nelement vertex 3\nproperty double x\nproperty double y\nproperty double z\n\
        element face 1\nproperty list uchar int vertex_indices\nend_header\n\
        4000000.1 0 0\n4000001.2 0 0\n4000000.3 1 0\n3 0 1 2\n";
    let asset = parse(text.as_bytes()).unwrap();
    assert!(asset.warnings.iter().any(|w| w.contains("single precision")), "{:?}", asset.warnings);
}

#[test]
fn colors_from_linear_light_become_bytes_on_the_curve_of_screens() {
    let mut mesh = shapes::tetrahedron();
    mesh.set_wedge_attribute(Attribute::new_f32(Semantic::Color(0), 3, vec![0.5; 12]));
    let bytes = bytes_of(&Asset::from_mesh("", mesh), "a.ply", &BINARY);
    assert!(String::from_utf8_lossy(&bytes).contains("property uchar red\n"));
    let value = mesh_of(&bytes).wedge_attributes[0].as_f32().unwrap()[0];
    // 0.5 in linear light is 188 of 255 on the sRGB curve
    assert_eq!(value, 188.0 / 255.0);
}

#[test]
fn nothing_is_left_behind_by_a_writer_that_fails() {
    let folder = tempfile::tempdir().unwrap();
    let asset = Asset::from_mesh("", shapes::sphere(5));
    let stop = AtomicBool::new(true);
    for name in ["a.ply", "a.obj", "a.stl", "a.off", "a.unknown", "none/a.ply"] {
        let path = folder.path().join(name);
        let error = write_with(&asset, &path, &BINARY, Control::new(None, Some(&stop))).unwrap_err();
        assert!(error.to_string().contains(name), "{error}");
        assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 0, "{name}");
    }
    assert!(write(&asset, folder.path(), &BINARY).is_err());
}

#[test]
fn a_file_can_be_written_over_what_it_was_read_from() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.ply");
    // large enough to be mapped
    let mesh = shapes::sphere(7);
    write(&Asset::from_mesh("", mesh.clone()), &path, &BINARY).unwrap();
    let asset = read(&path, &ReadOptions::default()).unwrap();
    write(&asset, &path, &BINARY).unwrap();
    assert_eq!(read(&path, &ReadOptions::default()).unwrap().meshes[0].mesh, mesh);
}

#[test]
fn the_number_of_threads_does_not_change_the_result() {
    let mut mesh = shapes::sphere(6);
    mesh.set_wedge_attribute(Attribute::new_f32(Semantic::Normal, 3, mesh.positions.as_flattened().to_vec()));
    let asset = Asset::from_mesh("", mesh);
    for name in ["a.ply", "a.obj"] {
        let run = |threads| {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
            pool.install(|| {
                let bytes = bytes_of(&asset, name, &BINARY);
                (mesh_of(&bytes), bytes)
            })
        };
        assert!(run(1) == run(3), "{name}");
    }
}
