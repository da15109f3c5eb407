//! What glTF can hold, in small files made here: read right, written back whole, refused when broken.

use std::path::Path;

use glam::{DVec3, Vec3};
use maille::mesh::{ComponentType, Values, shapes};
use maille::samples::Character;
use maille::skin::{Channel, Clip, Interpolation, Joint, Keys, Skeleton};
use maille::{Attribute, Mesh, Semantic};
use maille_io::{
    Asset, GeomorphForm, LevelTarget, LodOptions, ReadError, ReadOptions, WriteOptions, lod_chain, read, read_bytes,
    write,
};
use proptest::prelude::*;
use serde_json::{Value, json};

/// A glTF under construction: JSON, and the bytes of its one buffer.
struct File {
    json: Value,
    bytes: Vec<u8>,
}

const FLOAT: u32 = 5126;
const U8: u32 = 5121;
const U16: u32 = 5123;
const U32: u32 = 5125;

fn floats(values: &[f32]) -> Vec<u8> {
    values.iter().flat_map(|value| value.to_le_bytes()).collect()
}

fn shorts(values: &[u16]) -> Vec<u8> {
    values.iter().flat_map(|value| value.to_le_bytes()).collect()
}

/// The unit square in the plane z = 0, as corners of a strip.
const SQUARE: [f32; 12] = [0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 1.0, 1.0, 0.0];
const SQUARE_TRIANGLES: [u16; 6] = [0, 1, 2, 2, 1, 3];

impl File {
    fn empty() -> Self {
        let json = json!({
            "asset": { "version": "2.0" },
            "buffers": [], "bufferViews": [], "accessors": [],
            "meshes": [{ "primitives": [{ "attributes": {} }] }],
            "nodes": [{ "mesh": 0 }], "scenes": [{ "nodes": [0] }], "scene": 0,
        });
        Self { json, bytes: Vec::new() }
    }

    /// The unit square as two indexed triangles.
    fn square() -> Self {
        let mut file = Self::empty();
        let positions = file.accessor(FLOAT, "VEC3", 4, &floats(&SQUARE));
        let indices = file.accessor(U16, "SCALAR", 6, &shorts(&SQUARE_TRIANGLES));
        *file.primitive() = json!({ "attributes": { "POSITION": positions }, "indices": indices });
        file
    }

    fn primitive(&mut self) -> &mut Value {
        &mut self.json["meshes"][0]["primitives"][0]
    }

    fn push(&mut self, key: &str, entry: Value) -> usize {
        let list = self.json[key].as_array_mut().unwrap();
        list.push(entry);
        list.len() - 1
    }

    fn view(&mut self, bytes: &[u8]) -> usize {
        self.bytes.resize(self.bytes.len().next_multiple_of(4), 0);
        let offset = self.bytes.len();
        self.bytes.extend_from_slice(bytes);
        self.push("bufferViews", json!({ "buffer": 0, "byteOffset": offset, "byteLength": bytes.len() }))
    }

    fn accessor(&mut self, component: u32, shape: &str, count: usize, bytes: &[u8]) -> usize {
        let view = self.view(bytes);
        let accessor = json!({ "bufferView": view, "componentType": component, "count": count, "type": shape });
        self.push("accessors", accessor)
    }

    /// Gives the primitive an attribute.
    fn attribute(&mut self, name: &str, component: u32, shape: &str, bytes: &[u8]) -> &mut Value {
        let accessor = self.accessor(component, shape, 4, bytes);
        self.primitive()["attributes"][name] = json!(accessor);
        &mut self.json["accessors"][accessor]
    }

    /// Gives the first animation a channel.
    fn channel(&mut self, interpolation: &str, times: &[f32], output: usize, node: usize, path: &str) {
        let input = self.accessor(FLOAT, "SCALAR", times.len(), &floats(times));
        if self.json.get("animations").is_none() {
            self.json["animations"] = json!([{ "channels": [], "samplers": [] }]);
        }
        let animation = &mut self.json["animations"][0];
        let samplers = animation["samplers"].as_array_mut().unwrap();
        samplers.push(json!({ "input": input, "output": output, "interpolation": interpolation }));
        let sampler = samplers.len() - 1;
        let target = json!({ "node": node, "path": path });
        animation["channels"].as_array_mut().unwrap().push(json!({ "sampler": sampler, "target": target }));
    }

    fn glb(&self) -> Vec<u8> {
        let mut json = self.json.clone();
        if json["buffers"].as_array().is_some_and(Vec::is_empty) {
            json["buffers"] = json!([{ "byteLength": self.bytes.len() }]);
        }
        glb(&serde_json::to_vec(&json).unwrap(), &self.bytes)
    }

    fn read(&self) -> Result<Asset, ReadError> {
        read_bytes(&self.glb(), None, &ReadOptions::default())
    }

    fn mesh(&self) -> Mesh {
        let asset = self.read().unwrap_or_else(|error| panic!("{error}"));
        asset.meshes[0].mesh.check().unwrap();
        asset.meshes[0].mesh.clone()
    }

    fn refused(&self) -> String {
        self.read().map(|_| ()).expect_err("the file is broken").to_string()
    }
}

fn glb(text: &[u8], binary: &[u8]) -> Vec<u8> {
    let mut text = text.to_vec();
    text.resize(text.len().next_multiple_of(4), b' ');
    let mut binary = binary.to_vec();
    binary.resize(binary.len().next_multiple_of(4), 0);
    let mut glb = b"glTF\x02\0\0\0".to_vec();
    glb.extend(((28 + text.len() + binary.len()) as u32).to_le_bytes());
    for (kind, chunk) in [(b"JSON", &text), (b"BIN\0", &binary)] {
        glb.extend((chunk.len() as u32).to_le_bytes());
        glb.extend(kind);
        glb.extend(chunk);
    }
    glb
}

/// The JSON and the binary chunk of a GLB.
fn split(glb: &[u8]) -> (Value, Vec<u8>) {
    let length = u32::from_le_bytes(glb[12..16].try_into().unwrap()) as usize;
    let binary = glb.get(28 + length..).unwrap_or_default().to_vec();
    (serde_json::from_slice(&glb[20..20 + length]).unwrap(), binary)
}

fn written(asset: &Asset) -> Vec<u8> {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("out.glb");
    write(asset, &path, &WriteOptions::default()).unwrap_or_else(|error| panic!("{error}"));
    std::fs::read(path).unwrap()
}

fn reread(asset: &Asset) -> Asset {
    read_bytes(&written(asset), None, &ReadOptions::default()).unwrap_or_else(|error| panic!("{error}"))
}

/// The same triangles in another order: a change that leaves everything else to compare.
fn touched(mut asset: Asset) -> Asset {
    asset.meshes[0].mesh.triangles.reverse();
    asset
}

fn float_values<'a>(mesh: &'a Mesh, semantic: &Semantic) -> &'a [f32] {
    mesh.wedge_attribute(semantic).unwrap().as_f32().unwrap()
}

fn area(mesh: &Mesh) -> f64 {
    let area = |t| {
        let [a, b, c] = mesh.triangle_points(t);
        (b - a).cross(c - a).z / 2.0
    };
    (0..mesh.triangle_count()).map(area).sum()
}

#[test]
fn strips_fans_and_lists_without_indices_cover_the_same_square() {
    let square = File::square().mesh();
    assert_eq!((square.vertex_count(), square.triangle_count(), area(&square)), (4, 2, 1.0));
    let corners = |order: &[usize]| -> Vec<f32> { order.iter().flat_map(|&i| SQUARE[3 * i..][..3].to_vec()).collect() };
    for (mode, order) in [(5, &[0, 1, 2, 3][..]), (6, &[0, 1, 3, 2]), (4, &[0, 1, 2, 2, 1, 3])] {
        let mut file = File::empty();
        let positions = file.accessor(FLOAT, "VEC3", order.len(), &floats(&corners(order)));
        *file.primitive() = json!({ "attributes": { "POSITION": positions }, "mode": mode });
        let mesh = file.mesh();
        assert_eq!((mesh.vertex_count(), mesh.triangle_count(), area(&mesh)), (4, 2, 1.0), "mode {mode}");
    }
    // the repeated indices that join strips are no triangles
    let mut file = File::square();
    let indices = file.accessor(U32, "SCALAR", 6, &[0u32, 1, 2, 3, 3, 3].map(u32::to_le_bytes).concat());
    file.primitive()["indices"] = json!(indices);
    file.primitive()["mode"] = json!(5);
    assert_eq!(area(&file.mesh()), 1.0);
}

#[test]
fn every_component_type_and_shape_is_decoded_and_written_back() {
    let mut file = File::square();
    file.attribute("COLOR_0", U8, "VEC4", &[0, 51, 255, 255].repeat(4))["normalized"] = json!(true);
    file.attribute("COLOR_1", U16, "VEC3", &[[0, 0, 0x33, 0x33, 0xff, 0xff, 0, 0]; 4].concat())["normalized"] =
        json!(true);
    let view = file.json["accessors"].as_array().unwrap().len() - 1;
    let view = file.json["accessors"][view]["bufferView"].as_u64().unwrap() as usize;
    file.json["bufferViews"][view]["byteStride"] = json!(8);
    file.attribute("TEXCOORD_0", FLOAT, "VEC2", &floats(&[0.25, -7.5].repeat(4)));
    file.attribute("_I8", 5120, "SCALAR", &[0x80, 0, 0, 0, 0xff, 0, 0, 0, 1, 0, 0, 0, 127, 0, 0, 0]);
    file.attribute("_I16", 5122, "SCALAR", &[0, 0x80, 0, 0, 0xff, 0xff, 0, 0, 1, 0, 0, 0, 0xff, 0x7f, 0, 0]);
    file.attribute("_ID", U16, "SCALAR", &[7, 0, 0, 0, 8, 0, 0, 0, 9, 1, 0, 0, 10, 0, 0, 0]);
    for name in ["_I8", "_I16", "_ID"] {
        let accessor = file.primitive()["attributes"][name].as_u64().unwrap() as usize;
        let view = file.json["accessors"][accessor]["bufferView"].as_u64().unwrap() as usize;
        file.json["bufferViews"][view]["byteStride"] = json!(4);
    }
    // the columns of small matrices are padded to four bytes
    file.attribute("_M", U8, "MAT2", &[1, 2, 0, 0, 3, 4, 0, 0].repeat(4));
    let check = |mesh: &Mesh| {
        assert_eq!(float_values(mesh, &Semantic::Color(0))[..4], [0.0, 0.2, 1.0, 1.0]);
        assert_eq!(float_values(mesh, &Semantic::Color(1))[..3], [0.0, 0.2, 1.0]);
        assert_eq!(float_values(mesh, &Semantic::TexCoord(0))[..2], [0.25, -7.5]);
        assert_eq!(float_values(mesh, &Semantic::Custom("_I8".into())), [-128.0, -1.0, 1.0, 127.0]);
        assert_eq!(float_values(mesh, &Semantic::Custom("_I16".into())), [-32768.0, -1.0, 1.0, 32767.0]);
        let id = mesh.wedge_attribute(&Semantic::Custom("_ID".into())).unwrap();
        assert_eq!(id.values, Values::U32(vec![7, 8, 265, 10]));
        let matrix = mesh.wedge_attribute(&Semantic::Custom("_M".into())).unwrap();
        assert_eq!(matrix.as_u32().unwrap()[..4], [1, 2, 3, 4]);
    };
    let asset = file.read().unwrap();
    check(&asset.meshes[0].mesh);
    let again = reread(&touched(asset));
    check(&again.meshes[0].mesh);
    let (json, _) = split(&written(&again));
    let matrix = json["meshes"][0]["primitives"][0]["attributes"]["_M"].as_u64().unwrap() as usize;
    assert_eq!(json["accessors"][matrix]["type"], "MAT2");
    let storage = |n| again.meshes[0].mesh.wedge_attribute(&Semantic::Color(n)).unwrap().storage;
    assert_eq!((storage(0).component, storage(1).component), (ComponentType::U8, ComponentType::U16));
}

#[test]
fn interleaved_vertices_are_taken_apart() {
    let mut file = File::empty();
    let vertices: Vec<f32> = (0..4).flat_map(|i| [&SQUARE[3 * i..][..3], &[i as f32, -(i as f32)]].concat()).collect();
    let view = file.view(&floats(&vertices));
    file.json["bufferViews"][view]["byteStride"] = json!(20);
    let positions = json!({ "bufferView": view, "componentType": FLOAT, "count": 4, "type": "VEC3" });
    let uvs = json!({ "bufferView": view, "byteOffset": 12, "componentType": FLOAT, "count": 4, "type": "VEC2" });
    let (positions, uvs) = (file.push("accessors", positions), file.push("accessors", uvs));
    *file.primitive() = json!({ "attributes": { "POSITION": positions, "TEXCOORD_0": uvs }, "mode": 5 });
    let mesh = file.mesh();
    assert_eq!(area(&mesh), 1.0);
    assert_eq!(float_values(&mesh, &Semantic::TexCoord(0)), [0.0, 0.0, 1.0, -1.0, 2.0, -2.0, 3.0, -3.0]);
    let again = reread(&touched(file.read().unwrap()));
    assert_eq!(
        float_values(&again.meshes[0].mesh, &Semantic::TexCoord(0)),
        float_values(&mesh, &Semantic::TexCoord(0))
    );
}

#[test]
fn sparse_accessors_replace_elements_of_data_or_of_zeros() {
    for with_data in [true, false] {
        let mut file = File::square();
        let uvs = file.accessor(FLOAT, "VEC2", 4, &floats(&[1.0; 8]));
        let (indices, values) = (file.view(&[1, 3]), file.view(&floats(&[5.0, 6.0, 7.0, 8.0])));
        file.json["accessors"][uvs]["sparse"] = json!({
            "count": 2,
            "indices": { "bufferView": indices, "componentType": U8 },
            "values": { "bufferView": values },
        });
        if !with_data {
            file.json["accessors"][uvs].as_object_mut().unwrap().remove("bufferView");
        }
        file.primitive()["attributes"]["TEXCOORD_0"] = json!(uvs);
        let base = if with_data { 1.0 } else { 0.0 };
        assert_eq!(float_values(&file.mesh(), &Semantic::TexCoord(0)), [base, base, 5.0, 6.0, base, base, 7.0, 8.0]);
        file.json["accessors"][uvs]["sparse"]["indices"]["byteOffset"] = json!(1);
        assert!(file.refused().contains("sparse.indices"), "{}", file.refused());
    }
}

#[test]
fn buffers_come_from_data_uris_and_from_files_beside_but_from_nowhere_else() {
    let file = File::square();
    let folder = tempfile::tempdir().unwrap();
    let bin = folder.path().join("my data.bin");
    std::fs::write(&bin, &file.bytes).unwrap();
    let read_with = |uri: &str| {
        let mut json = file.json.clone();
        json["buffers"] = json!([{ "byteLength": file.bytes.len(), "uri": uri }]);
        let path = folder.path().join("square.gltf");
        std::fs::write(&path, json.to_string()).unwrap();
        read(&path, &ReadOptions::default())
    };
    let percent: String = file.bytes.iter().map(|byte| format!("%{byte:02x}")).collect();
    for uri in [&format!("data:application/octet-stream,{percent}"), "my%20data.bin", "./my data.bin"] {
        assert_eq!(area(&read_with(uri).unwrap().meshes[0].mesh), 1.0, "{uri}");
    }
    let base64 = "data:;base64,AAAAAAAAAAAAAAAAAACAPwAAAAAAAAAAAAAAAAAAgD8AAAAAAACAPwAAgD8AAAAAAAABAAIAAgABAAMA";
    assert_eq!(area(&read_with(base64).unwrap().meshes[0].mesh), 1.0);
    let absolute = bin.display().to_string();
    for uri in ["../my data.bin", &absolute, "file:///etc/passwd", "https://a.example/b.bin", "%2e%2e/b", "data:x"] {
        let error = read_with(uri).map(|_| ()).expect_err(uri).to_string();
        assert!(error.contains("buffers[0]"), "{error}");
    }
}

#[test]
fn quantised_positions_keep_their_grid_while_they_fit() {
    let mut file = File::square();
    let positions: Vec<u8> =
        SQUARE.chunks(3).flat_map(|p| shorts(&[p[0] as u16 * 100, p[1] as u16 * 100, 0, 0])).collect();
    file.attribute("POSITION", U16, "VEC3", &positions);
    let view = file.json["bufferViews"].as_array().unwrap().len() - 1;
    file.json["bufferViews"][view]["byteStride"] = json!(8);
    file.json["extensionsUsed"] = json!(["KHR_mesh_quantization", "KHR_texture_transform"]);
    file.json["extensionsRequired"] = json!(["KHR_mesh_quantization"]);
    let mut asset = file.read().unwrap();
    assert_eq!(area(&asset.meshes[0].mesh), 1e4);
    asset.meshes[0].mesh.positions[1] = [50.4, 0.0, 0.0];
    let (json, _) = split(&written(&asset));
    let position = json["meshes"][0]["primitives"][0]["attributes"]["POSITION"].as_u64().unwrap() as usize;
    assert_eq!(json["accessors"][position]["componentType"], U16);
    assert_eq!(json["accessors"][position]["max"], json!([100, 100, 0]));
    assert_eq!(reread(&asset).meshes[0].mesh.positions[1], [50.0, 0.0, 0.0]);
    // off the grid they become floats, and the extension goes
    asset.meshes[0].mesh.positions[1] = [-50.5, 0.0, 0.0];
    let (json, _) = split(&written(&asset));
    assert_eq!(json["extensionsUsed"], json!(["KHR_texture_transform"]));
    assert_eq!(json.get("extensionsRequired"), None);
    assert_eq!(reread(&asset).meshes[0].mesh.positions[1], [-50.5, 0.0, 0.0]);
}

/// The square, its data compressed with meshopt under the given name of the extension.
fn compressed_square(name: &str, sequence: bool) -> File {
    let mut file = File::empty();
    let points: Vec<[f32; 3]> = SQUARE.as_chunks().0.to_vec();
    let positions = meshopt::encode_vertex_buffer(&points).unwrap();
    let normals = meshopt::encode_filter_oct::<i8>(&[[0.0, 0.0, 1.0, 0.0]; 4], 8);
    let normals = meshopt::encode_vertex_buffer(&normals).unwrap();
    let uvs = meshopt::encode_filter_exp::<2>(&[[0.5, 0.25]; 4], 15, meshopt::EncodeExpMode::Separate);
    let uvs = meshopt::encode_vertex_buffer(&uvs).unwrap();
    let corners: Vec<u32> = SQUARE_TRIANGLES.iter().map(|&i| u32::from(i)).collect();
    let (mode, indices) = match sequence {
        true => ("INDICES", meshopt::encode_index_sequence(&corners, 4).unwrap()),
        false => ("TRIANGLES", meshopt::encode_index_buffer(&corners, 4).unwrap()),
    };
    let mut add = |bytes: &[u8], stride: usize, count: usize, mode: &str, filter: &str, accessor: Value| {
        let view = file.view(bytes);
        let offset = file.json["bufferViews"][view]["byteOffset"].clone();
        let extension = json!({
            "buffer": 0, "byteOffset": offset, "byteLength": bytes.len(), "byteStride": stride, "count": count,
            "mode": mode, "filter": filter,
        });
        let mut plain =
            json!({ "buffer": 1, "byteOffset": 0, "byteLength": stride * count, "extensions": { name: extension } });
        if mode == "ATTRIBUTES" {
            plain["byteStride"] = json!(stride);
        }
        file.json["bufferViews"][view] = plain;
        let mut accessor = accessor;
        accessor["bufferView"] = json!(view);
        accessor["count"] = json!(count);
        file.push("accessors", accessor)
    };
    let float = |shape: &str| json!({ "componentType": FLOAT, "type": shape });
    let positions = add(&positions, 12, 4, "ATTRIBUTES", "NONE", float("VEC3"));
    let normal = json!({ "componentType": 5120, "type": "VEC3", "normalized": true });
    let normals = add(&normals, 4, 4, "ATTRIBUTES", "OCTAHEDRAL", normal);
    let uvs = add(&uvs, 8, 4, "ATTRIBUTES", "EXPONENTIAL", float("VEC2"));
    let indices = add(&indices, 2, 6, mode, "NONE", json!({ "componentType": U16, "type": "SCALAR" }));
    *file.primitive() = json!({
        "attributes": { "POSITION": positions, "NORMAL": normals, "TEXCOORD_0": uvs }, "indices": indices,
    });
    let fallback = json!({ "byteLength": 1000, "extensions": { name: { "fallback": true } } });
    file.json["buffers"] = json!([{ "byteLength": file.bytes.len() }, fallback]);
    file.json["extensionsUsed"] = json!([name, "KHR_mesh_quantization"]);
    file.json["extensionsRequired"] = json!([name, "KHR_mesh_quantization"]);
    file
}

#[test]
fn meshopt_compression_is_read_and_written_plain() {
    for (name, sequence) in [("EXT_meshopt_compression", false), ("KHR_meshopt_compression", true)] {
        let file = compressed_square(name, sequence);
        let asset = file.read().unwrap_or_else(|error| panic!("{error}"));
        let mesh = &asset.meshes[0].mesh;
        assert_eq!(area(mesh), 1.0);
        assert_eq!(float_values(mesh, &Semantic::Normal)[..3], [0.0, 0.0, 1.0]);
        assert_eq!(float_values(mesh, &Semantic::TexCoord(0))[..2], [0.5, 0.25]);
        let (json, _) = split(&written(&asset));
        assert_eq!(json["extensionsRequired"], json!(["KHR_mesh_quantization"]));
        assert_eq!(json["buffers"].as_array().unwrap().len(), 1);
        assert!(!json.to_string().contains("meshopt"));
        assert_eq!(reread(&asset).meshes[0].mesh, *mesh);
    }
}

#[test]
fn broken_meshopt_data_is_refused() {
    let mut file = compressed_square("EXT_meshopt_compression", false);
    for (key, value) in [
        ("count", json!(4_000_000_000u64)),
        ("byteStride", json!(3)),
        ("byteStride", json!(260)),
        ("mode", json!("SOMETHING")),
        ("filter", json!("QUATERNION")),
        ("byteLength", json!(3)),
        ("byteOffset", json!(u64::MAX)),
        ("buffer", json!(9)),
    ] {
        let whole = file.json.clone();
        file.json["bufferViews"][0]["extensions"]["EXT_meshopt_compression"][key] = value;
        assert!(file.refused().contains("bufferViews[0].extensions.EXT_meshopt_compression"), "{}", file.refused());
        file.json = whole;
    }
}

#[test]
fn what_maille_does_not_know_comes_out_as_it_went_in() {
    let mut file = File::square();
    let secret = file.view(b"0123456789");
    let extension =
        json!({ "ACME_thing": { "bufferView": secret, "deep": [{ "a": [1, 2.5, -1e-30] }, null, "ß\u{1F600}"] } });
    file.json["extensions"] = extension.clone();
    file.json["extensionsUsed"] = json!(["ACME_thing", "KHR_lights_punctual"]);
    file.json["nodes"][0]["extras"] = json!({ "tag": 0.1, "big": 12345678901234567890u64 });
    file.json["materials"] =
        json!([{ "name": "m", "extensions": { "ACME_thing": {} }, "emissiveFactor": [0.3, 0.1, 0.7] }]);
    file.json["cameras"] = json!([{ "type": "perspective", "perspective": { "yfov": 0.7, "znear": 0.01 } }]);
    file.primitive()["extensions"] =
        json!({ "KHR_materials_variants": { "mappings": [{ "material": 0, "variants": [0] }] } });
    file.primitive()["extras"] = json!("kept");
    file.json["meshes"][0]["extras"] = json!({ "targetNames": [], "x": [] });
    for asset in [file.read().unwrap(), touched(file.read().unwrap())] {
        let (json, binary) = split(&written(&asset));
        for key in ["extensions", "extensionsUsed", "nodes", "materials", "cameras", "asset", "scenes", "scene"] {
            assert_eq!(json[key].to_string(), file.json[key].to_string());
        }
        for key in ["extensions", "extras"] {
            assert_eq!(json["meshes"][0]["primitives"][0][key], file.json["meshes"][0]["primitives"][0][key]);
        }
        assert_eq!(json["meshes"][0]["extras"], file.json["meshes"][0]["extras"]);
        let offset = json["bufferViews"][secret]["byteOffset"].as_u64().unwrap() as usize;
        assert_eq!(&binary[offset..offset + 10], b"0123456789");
    }
}

#[test]
fn points_and_lines_pass_through_beside_triangles() {
    let mut file = File::square();
    let points = file.accessor(FLOAT, "VEC3", 4, &floats(&SQUARE));
    let primitive = json!({ "attributes": { "POSITION": points }, "mode": 1, "material": 0 });
    file.json["materials"] = json!([{}]);
    file.json["meshes"][0]["primitives"].as_array_mut().unwrap().insert(0, primitive.clone());
    let asset = file.read().unwrap();
    assert_eq!(asset.meshes[0].mesh.triangle_materials, [1, 1]);
    let (json, _) = split(&written(&touched(asset)));
    let first = &json["meshes"][0]["primitives"][0];
    assert_eq!(first["mode"], 1);
    let view = &json["bufferViews"][json["accessors"][points]["bufferView"].as_u64().unwrap() as usize];
    assert_eq!(
        (first["attributes"]["POSITION"].as_u64(), view["byteLength"].as_u64()),
        (Some(points as u64), Some(48))
    );
}

#[test]
fn primitives_stay_apart_and_get_back_only_the_attributes_that_they_had() {
    let mut file = File::square();
    let indices = file.primitive()["indices"].clone();
    file.attribute("COLOR_0", FLOAT, "VEC3", &floats(&[0.5; 12]));
    let positions = file.accessor(FLOAT, "VEC3", 4, &floats(&SQUARE));
    file.push("meshes", json!({}));
    let plain = json!({ "attributes": { "POSITION": positions }, "indices": indices });
    file.json["meshes"].as_array_mut().unwrap().pop();
    file.json["meshes"][0]["primitives"].as_array_mut().unwrap().push(plain);
    let asset = file.read().unwrap();
    let mesh = &asset.meshes[0].mesh;
    assert_eq!((mesh.vertex_count(), mesh.wedge_count(), mesh.triangle_count()), (4, 8, 4));
    assert_eq!(mesh.triangle_materials, [0, 0, 1, 1]);
    let colors = float_values(mesh, &Semantic::Color(0));
    assert_eq!((&colors[..3], &colors[21..]), (&[0.5; 3][..], &[1.0; 3][..]));
    let mut changed = asset.clone();
    changed.meshes[0].mesh.triangles.swap(0, 1);
    let (json, _) = split(&written(&changed));
    let primitives = json["meshes"][0]["primitives"].as_array().unwrap();
    let names = |i: usize| primitives[i]["attributes"].as_object().unwrap().keys().cloned().collect::<Vec<_>>();
    assert_eq!((names(0), names(1)), (vec!["POSITION".into(), "COLOR_0".into()], vec!["POSITION".into()]));
    // a primitive without triangles goes; a mesh without any keeps a point that draws nothing
    changed.meshes[0].mesh.triangles.truncate(2);
    changed.meshes[0].mesh.triangle_materials.truncate(2);
    assert_eq!(split(&written(&changed)).0["meshes"][0]["primitives"].as_array().unwrap().len(), 1);
    changed.meshes[0].mesh.triangles.clear();
    changed.meshes[0].mesh.triangle_materials.clear();
    let again = reread(&changed);
    assert_eq!(again.meshes[0].mesh.triangle_count(), 1);
    assert_eq!(again.merged_positions().diagonal(), 0.0);
}

#[test]
fn indices_are_as_narrow_as_they_can_be() {
    for (steps, component) in [(200, U16), (256, U32)] {
        let (json, _) = split(&written(&Asset::from_mesh("grid", shapes::grid(steps))));
        let indices = json["meshes"][0]["primitives"][0]["indices"].as_u64().unwrap() as usize;
        assert_eq!(json["accessors"][indices]["componentType"], component);
    }
}

#[test]
fn non_finite_positions_take_their_triangles_with_them() {
    let mut file = File::square();
    let mut points = SQUARE;
    points[10] = f32::NAN;
    file.attribute("POSITION", FLOAT, "VEC3", &floats(&points));
    let asset = file.read().unwrap();
    assert_eq!((asset.meshes[0].mesh.triangle_count(), asset.meshes[0].mesh.vertex_count()), (1, 3));
    assert_eq!(asset.warnings.len(), 1);
    assert!(asset.warnings[0].contains("meshes[0].primitives[0]"), "{}", asset.warnings[0]);
}

#[test]
fn weights_sum_to_one_normals_are_unit_and_tangents_have_a_sign() {
    for (component, width) in [(U8, 1), (U16, 2), (FLOAT, 4)] {
        let mut file = File::square();
        file.attribute(
            "NORMAL",
            FLOAT,
            "VEC3",
            &floats(&[0.0, 0.0, 3.0, 0.0, 0.0, 0.0, 1.0, 1.0, 0.0, f32::NAN, 0.0, 0.0]),
        );
        file.attribute(
            "TANGENT",
            FLOAT,
            "VEC4",
            &floats(&[0.0, 2.0, 0.0, -0.5, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0, 1.0, 1.0, 0.0, 0.0, 1.0]),
        );
        file.attribute("JOINTS_0", U8, "VEC4", &[1, 1, 2, 9].repeat(4));
        let weights: Vec<u8> = match width {
            1 => [70, 30, 33, 0].repeat(4),
            2 => shorts(&[7000, 3000, 3333, 0].repeat(4)),
            _ => floats(&[0.7, 0.3, 0.333, 0.0].repeat(4)),
        };
        file.attribute("WEIGHTS_0", component, "VEC4", &weights)["normalized"] = json!(component != FLOAT);
        let mesh = reread(&touched(file.read().unwrap())).meshes.remove(0).mesh;
        let length = |v: &[f32]| v.iter().map(|x| f64::from(x * x)).sum::<f64>().sqrt();
        assert!(float_values(&mesh, &Semantic::Normal).chunks(3).all(|n| (length(n) - 1.0).abs() < 1e-6));
        assert_eq!(float_values(&mesh, &Semantic::Normal)[3..6], [0.0, 0.0, 1.0]);
        let tangents = float_values(&mesh, &Semantic::Tangent);
        assert!(tangents.chunks(4).all(|t| (length(&t[..3]) - 1.0).abs() < 1e-6 && t[3].abs() == 1.0));
        let weights = mesh.wedge_attribute(&Semantic::Weights(0)).unwrap();
        let steps = if component == FLOAT { 1.0 } else { [255.0, 65535.0][width - 1] };
        for (w, j) in weights
            .as_f32()
            .unwrap()
            .chunks(4)
            .zip(mesh.wedge_attribute(&Semantic::Joints(0)).unwrap().as_u32().unwrap().chunks(4))
        {
            let sum: f64 = w.iter().map(|&w| (f64::from(w) * steps * 1e6).round() / 1e6).sum();
            assert!((sum - steps).abs() < 1e-6 * steps, "{w:?}");
            // the joint that was named twice counts once, the one without weight is joint 0
            assert_eq!((w[1], w[3], j), (0.0, 0.0, &[1, 0, 2, 0][..]));
        }
    }
}

#[test]
fn nodes_skins_morphs_and_instances_say_where_things_are() {
    let mut file = File::square();
    let (parent, child) =
        (json!({ "children": [1], "scale": [2, 2, 2] }), json!({ "mesh": 0, "translation": [1, 0, 0] }));
    file.json["nodes"] = json!([parent, child]);
    let bounds = |file: &File| file.read().unwrap().merged_positions().bounds().unwrap();
    assert_eq!(bounds(&file), ([2.0, 0.0, 0.0], [4.0, 2.0, 0.0]));
    // morph targets that are on at rest
    let target = file.accessor(FLOAT, "VEC3", 4, &floats(&[0.0, 0.0, 4.0].repeat(4)));
    file.primitive()["targets"] = json!([{ "POSITION": target }]);
    file.json["meshes"][0]["weights"] = json!([0.5]);
    file.json["meshes"][0]["extras"] = json!({ "targetNames": ["lift"] });
    assert_eq!(bounds(&file), ([2.0, 0.0, 4.0], [4.0, 2.0, 4.0]));
    let asset = file.read().unwrap();
    assert_eq!(asset.meshes[0].mesh.morph_targets[0].name, "lift");
    let again = reread(&touched(asset));
    assert_eq!(again.merged_positions().bounds().unwrap(), ([2.0, 0.0, 4.0], [4.0, 2.0, 4.0]));
    // instances by extension, below the node
    let (moves, scales) = (floats(&[0.0, 0.0, 0.0, 10.0, 0.0, 0.0]), floats(&[1.0, 1.0, 1.0, 3.0, 3.0, 3.0]));
    let (moves, scales) = (file.accessor(FLOAT, "VEC3", 2, &moves), file.accessor(FLOAT, "VEC3", 2, &scales));
    file.json["nodes"][1]["weights"] = json!([0]);
    file.json["nodes"][1]["extensions"] =
        json!({ "EXT_mesh_gpu_instancing": { "attributes": { "TRANSLATION": moves, "SCALE": scales } } });
    assert_eq!(file.read().unwrap().instances.len(), 2);
    assert_eq!(bounds(&file), ([2.0, 0.0, 0.0], [28.0, 6.0, 0.0]));
    let again = reread(&touched(file.read().unwrap()));
    assert_eq!(again.merged_positions().bounds().unwrap(), ([2.0, 0.0, 0.0], [28.0, 6.0, 0.0]));
}

#[test]
fn hostile_documents_are_refused_with_the_place() {
    let huge = json!(u64::MAX);
    let cases: Vec<(&str, Value, &str)> = vec![
        ("/accessors/0/count", json!(4_000_000_000u64), "accessors[0]"),
        ("/accessors/0/count", huge.clone(), "accessors[0]"),
        ("/accessors/0/count", json!(-1), "accessors[0]"),
        ("/accessors/0/count", json!("many"), "accessors[0]"),
        ("/accessors/0/count", json!(2.5), "accessors[0]"),
        ("/accessors/0/componentType", json!(5124), "accessors[0]"),
        ("/accessors/0/type", json!("VEC9"), "accessors[0]"),
        ("/accessors/0/type", json!("VEC2"), "POSITION"),
        ("/accessors/0/byteOffset", huge.clone(), "accessors[0]"),
        ("/accessors/0/bufferView", json!(77), "accessors[0]"),
        ("/accessors/1/componentType", json!(FLOAT), "indices"),
        ("/accessors", json!({}), "accessors"),
        ("/bufferViews/0/byteLength", huge.clone(), "bufferViews[0]"),
        ("/bufferViews/0/byteOffset", json!(60), "bufferViews[0]"),
        ("/bufferViews/0/buffer", json!(3), "bufferViews[0]"),
        ("/bufferViews/0/byteStride", json!(0), "bufferViews[0]"),
        ("/bufferViews/0/byteStride", json!(4), "accessors[0]"),
        ("/buffers", json!([{ "byteLength": 5_000_000_000u64 }]), "buffers[0]"),
        ("/accessors", json!([5]), "accessors[0]"),
        ("/meshes", json!(7), "meshes"),
        ("/meshes/0", json!(7), "meshes[0]"),
        ("/meshes/0/primitives/0", json!(7), "meshes[0].primitives[0]"),
        ("/meshes/0/primitives", json!({}), "meshes[0].primitives"),
        ("/meshes/0/primitives/0/mode", json!(7), "meshes[0].primitives[0].mode"),
        ("/meshes/0/primitives/0/indices", json!(9), "meshes[0].primitives[0].indices"),
        ("/meshes/0/primitives/0/attributes/POSITION", json!(9), "meshes[0].primitives[0].attributes.POSITION"),
        ("/meshes/0/primitives/0/attributes", json!({ "POSITION": 0, "NORMAL": 1 }), "attributes.NORMAL"),
        ("/nodes", json!([{ "mesh": 0, "children": [0] }]), "nodes[0]"),
        ("/nodes", json!([{ "mesh": 0 }, { "children": [2] }, { "children": [1] }]), "nodes[1]"),
        ("/nodes", json!([{ "mesh": 0, "children": [2] }, { "children": [2] }, {}]), "nodes[1].children[0]"),
        ("/nodes", json!([{ "mesh": 0, "children": [5] }]), "nodes[0].children[0]"),
        ("/nodes", json!([{ "mesh": 5 }]), "nodes[0].mesh"),
        ("/nodes", json!([{ "mesh": 0, "skin": 0 }]), "nodes[0].skin"),
        ("/nodes", json!([{ "mesh": 0, "matrix": [1, 2] }]), "nodes[0].matrix"),
        ("/nodes", json!([{ "mesh": 0, "weights": ["a"] }]), "nodes[0].weights"),
        ("/scene", json!(4), "scene"),
        ("/scenes/0/nodes", json!([8]), "scenes[0].nodes[0]"),
        ("/asset/version", json!("1.0"), "asset"),
    ];
    for (pointer, value, place) in cases {
        let mut file = File::square();
        let what = format!("{pointer} = {value}");
        match file.json.pointer_mut(pointer) {
            Some(target) => *target = value,
            None => {
                let (parent, key) = pointer.rsplit_once('/').unwrap();
                file.json.pointer_mut(parent).unwrap()[key] = value;
            }
        }
        let message = file.refused();
        assert!(message.contains(place), "{what}: {message}");
    }
    let mut file = File::square();
    file.bytes[48..50].copy_from_slice(&[9, 0]);
    assert!(file.refused().contains("meshes[0].primitives[0].indices"), "{}", file.refused());
    let deep = format!("{}{}", "[".repeat(100_000), "]".repeat(100_000));
    let deep = format!("{{\"asset\":{{\"version\":\"2.0\"}},\"extras\":{deep}}}");
    assert!(read_bytes(&glb(deep.as_bytes(), &[]), None, &ReadOptions::default()).is_err());
}

#[test]
fn levels_that_make_no_sense_are_told_from_chains() {
    let with = |ids: Value, second: Value| {
        let mut file = File::square();
        file.json["extensionsUsed"] = json!(["MSFT_lod"]);
        file.json["nodes"] = json!([{ "mesh": 0, "extensions": { "MSFT_lod": { "ids": ids } } }, second]);
        file.read().unwrap().split_levels().expect("a node lists levels")
    };
    for (ids, second) in [
        (json!([7]), json!({ "mesh": 0 })),
        (json!([-1]), json!({ "mesh": 0 })),
        (json!("many"), json!({ "mesh": 0 })),
        (json!([1]), json!({})),
        (json!([0]), json!({ "mesh": 0 })),
        (json!([1]), json!({ "mesh": 0, "extensions": { "MSFT_lod": { "ids": [0] } } })),
    ] {
        let what = format!("{ids} {second}");
        let reason = with(ids, second).expect_err(&what);
        assert!(reason.contains("nodes["), "{what}: {reason}");
    }
    // the level is the same mesh: odd, but a chain
    let (whole, levels) = with(json!([1, 1]), json!({ "mesh": 0 })).unwrap();
    assert_eq!((whole.meshes.len(), whole.instances.len(), levels.len()), (1, 1, 2));
}

#[test]
fn a_primitive_morphs_only_what_it_has() {
    let mut file = File::square();
    let bare = file.primitive().clone();
    file.attribute("TEXCOORD_0", FLOAT, "VEC2", &floats(&[0.0, 0.0, 1.0, 0.0, 0.0, 1.0, 1.0, 1.0]));
    let lifted = SQUARE.as_chunks::<3>().0.iter().flat_map(|&[x, y, z]| [x, y, z + 1.0]).collect::<Vec<f32>>();
    let lifted = file.accessor(FLOAT, "VEC3", 4, &floats(&lifted));
    let second = json!({ "attributes": { "POSITION": lifted }, "indices": bare["indices"] });
    file.json["meshes"][0]["primitives"].as_array_mut().unwrap().push(second);
    let asset = file.read().unwrap();
    let mut mesh = asset.meshes[0].mesh.clone();
    let uv = mesh.wedge_attributes.iter_mut().find(|own| own.semantic == Semantic::TexCoord(0)).unwrap();
    uv.as_f32_mut().unwrap().iter_mut().for_each(|x| *x *= 0.5);
    let level = LevelTarget::Meshes { meshes: vec![mesh], error: Some(0.5) };
    let geomorph = GeomorphForm { target: true, ..GeomorphForm::default() };
    let options = LodOptions { levels: vec![level], geomorph, ..LodOptions::default() };
    let chain = lod_chain(&asset, &options, Default::default()).unwrap_or_else(|error| panic!("{error}"));
    let (json, _) = split(&written(&asset.with_levels(&chain)));
    let keys = |object: &Value| object.as_object().unwrap().keys().cloned().collect::<Vec<String>>();
    let primitives = json["meshes"][0]["primitives"].as_array().unwrap();
    assert_eq!(keys(&primitives[0]["targets"][0]), ["POSITION", "TEXCOORD_0"]);
    assert_eq!(keys(&primitives[1]["targets"][0]), ["POSITION"]);
}

#[test]
fn a_chain_with_blend_shapes_is_read_back_with_its_clips() {
    let mut file = File::square();
    let lift = file.accessor(FLOAT, "VEC3", 4, &floats(&[0.0, 0.0, 4.0].repeat(4)));
    file.primitive()["targets"] = json!([{ "POSITION": lift }]);
    file.json["meshes"][0]["weights"] = json!([0.25]);
    file.json["meshes"][0]["extras"] = json!({ "targetNames": ["lift"] });
    let weights = file.accessor(FLOAT, "SCALAR", 2, &floats(&[0.0, 1.0]));
    file.channel("LINEAR", &[0.0, 2.0], weights, 0, "weights");
    let asset = file.read().unwrap();
    let level = LevelTarget::Meshes { meshes: vec![asset.meshes[0].mesh.clone()], error: Some(0.5) };
    let geomorph = GeomorphForm { target: true, attributes: true, merge_weights: false };
    let options = LodOptions { levels: vec![level], geomorph, ..LodOptions::default() };
    let chain = lod_chain(&asset, &options, Default::default()).unwrap_or_else(|error| panic!("{error}"));
    let mut whole = reread(&asset.with_levels(&chain));
    assert_eq!(whole.animation(0).instances_at(2.0)[0].morph_weights, [1.0, 0.0], "the geomorph stays off");
    // again and again: nothing is left over
    for _ in 0..2 {
        let (original, levels) = whole.split_levels().expect("it has levels").expect("they are a chain");
        assert_eq!(levels.len(), 1);
        let names = |mesh: &Mesh| mesh.morph_targets.iter().map(|target| target.name.clone()).collect::<Vec<String>>();
        assert!([&original.meshes[0].mesh, &levels[0].meshes[0]].into_iter().all(|mesh| names(mesh) == ["lift"]));
        let original = reread(&original);
        assert_eq!(original.clips(), asset.clips());
        assert_eq!(original.animation(0).instances_at(1.0)[0].morph_weights, [0.5]);
        assert_eq!((original.instances[0].morph_weights.as_slice(), original.meshes.len()), (&[0.25][..], 1));
        whole = reread(&original.with_levels(&chain));
    }
}

#[test]
fn a_small_file_cannot_ask_for_much_memory() {
    // zeros cost no bytes, so that nothing but a limit bounds them
    let mut file = File::square();
    let zeros = json!({ "componentType": FLOAT, "count": 4_000_000_000u64, "type": "VEC3" });
    let zeros = file.push("accessors", zeros);
    *file.primitive() = json!({ "attributes": { "POSITION": zeros } });
    assert!(file.refused().contains("count"));
    // many primitives over the same accessors, each of which is copied
    let mut file = File::empty();
    let positions = file.accessor(FLOAT, "VEC3", 60_000, &vec![0; 720_000]);
    let primitive = json!({ "attributes": { "POSITION": positions } });
    file.json["meshes"][0]["primitives"] = json!(vec![primitive; 10_000]);
    let limited = ReadOptions { max_bytes: 50 << 20 };
    let error = read_bytes(&file.glb(), None, &limited).map(|_| ()).unwrap_err().to_string();
    assert!(error.contains("more memory than allowed"), "{error}");
}

#[test]
fn every_prefix_of_a_glb_is_refused() {
    let glb = File::square().glb();
    for length in 1..glb.len() {
        let error = read_bytes(&glb[..length], None, &ReadOptions::default()).map(|_| ()).unwrap_err().to_string();
        assert!(error.ends_with(')'), "no remedy at {length} bytes: {error}");
        assert!(length < 4 || error.contains("GLB header") && error.contains("cut short"), "{length} bytes: {error}");
    }
    let longer = [glb, vec![0; 4]].concat();
    assert_eq!(read_bytes(&longer, None, &ReadOptions::default()).unwrap().warnings.len(), 1);
}

proptest! {
    #[test]
    fn damaged_bytes_never_panic(place in 0usize..4000, value: u8, draw in 0usize..3) {
        let file = match draw {
            0 => File::square(),
            1 => compressed_square("EXT_meshopt_compression", false),
            _ => {
                let mut file = arm();
                let turns = file.accessor(FLOAT, "VEC4", 2, &floats(&[turn_z(0.0), turn_z(1.0)].concat()));
                file.channel("LINEAR", &[0.0, 1.0], turns, 2, "rotation");
                file
            }
        };
        let mut glb = file.glb();
        let place = place % glb.len();
        glb[place] = value;
        if let Ok(asset) = read_bytes(&glb, None, &ReadOptions { max_bytes: 1 << 24 }) {
            asset.meshes.iter().for_each(|mesh| mesh.mesh.check().unwrap());
            for clip in 0..asset.clips().len() {
                prop_assert_eq!(asset.animation(clip).instances_at(0.5).len(), asset.instances.len());
            }
        }
    }
}

#[test]
fn images_beside_a_gltf_stay_with_the_output() {
    let folder = tempfile::tempdir().unwrap();
    let mut file = File::square();
    file.json["images"] = json!([{ "uri": "tex/a%20b.png" }, { "uri": "lost.png" }]);
    file.json["textures"] = json!([{ "source": 0 }, { "source": 1 }]);
    file.json["buffers"] = json!([{ "byteLength": file.bytes.len(), "uri": "square.bin" }]);
    std::fs::create_dir(folder.path().join("tex")).unwrap();
    std::fs::write(folder.path().join("tex/a b.png"), b"\x89PNG picture").unwrap();
    std::fs::write(folder.path().join("square.bin"), &file.bytes).unwrap();
    let path = folder.path().join("square.gltf");
    std::fs::write(&path, file.json.to_string()).unwrap();
    let asset = read(&path, &ReadOptions::default()).unwrap();
    // a GLB holds what it can find
    let (json, binary) = split(&written(&asset));
    let view = &json["bufferViews"][json["images"][0]["bufferView"].as_u64().unwrap() as usize];
    let offset = view["byteOffset"].as_u64().unwrap() as usize;
    assert!(binary[offset..].starts_with(b"\x89PNG picture"));
    assert_eq!(json["images"][0]["mimeType"], "image/png");
    assert_eq!(json["images"][1], file.json["images"][1]);
    // JSON in another folder gets a copy, in the same folder nothing changes
    let other = tempfile::tempdir().unwrap();
    let save = |folder: &Path| -> Value {
        write(&asset, &folder.join("o ut.gltf"), &WriteOptions::default()).unwrap();
        serde_json::from_slice(&std::fs::read(folder.join("o ut.gltf")).unwrap()).unwrap()
    };
    assert_eq!(save(other.path())["images"][0]["uri"], "a%20b.png");
    assert_eq!(std::fs::read(other.path().join("a b.png")).unwrap(), b"\x89PNG picture");
    let json = save(folder.path());
    assert_eq!(json["images"], file.json["images"]);
    assert_eq!(json["buffers"][0]["uri"], "o%20ut.bin");
    assert_eq!(
        read(&folder.path().join("o ut.gltf"), &ReadOptions::default()).unwrap().meshes[0].mesh,
        asset.meshes[0].mesh
    );
}

#[test]
fn meshes_of_other_origin_become_whole_documents() {
    let mut mesh = shapes::sphere(2);
    mesh.triangle_materials = (0..mesh.triangle_count() as u32).map(|t| t % 2).collect();
    mesh.material_names = vec!["red".into(), "blue".into()];
    let mut color = Attribute::new_f32(Semantic::Color(0), 3, vec![0.5; 3 * mesh.wedge_count()]);
    color.storage.component = ComponentType::U8;
    color.storage.normalized = true;
    color.storage.srgb = true;
    mesh.vertex_attributes =
        vec![color, Attribute::new_f32(Semantic::Custom("quality".into()), 1, vec![2.5; mesh.wedge_count()])];
    let asset = Asset::from_mesh("ball", mesh.clone());
    let again = reread(&asset);
    let ball = &again.meshes[0].mesh;
    assert_eq!((again.meshes[0].name.as_str(), &ball.material_names), ("ball", &mesh.material_names));
    assert_eq!(ball.triangle_count(), mesh.triangle_count());
    // half of full brightness on a screen is a fifth of the light
    assert!((float_values(ball, &Semantic::Color(0))[0] - 0.214).abs() < 1e-3);
    assert_eq!(float_values(ball, &Semantic::Custom("_QUALITY".into()))[0], 2.5);
    for (wedge, normal) in float_values(ball, &Semantic::Normal).chunks(3).enumerate() {
        let radius = ball.positions[ball.wedge_vertices[wedge] as usize].map(f64::from);
        let normal = DVec3::new(f64::from(normal[0]), f64::from(normal[1]), f64::from(normal[2]));
        assert!(normal.dot(radius.into()) > 0.98, "smooth normals of a sphere point outwards");
    }
}

#[test]
fn a_character_is_written_with_skeleton_clips_and_texture() {
    let mut mesh = shapes::cube();
    let joints = [[0, 1, 0, 0]; 8].concat();
    mesh.wedge_attributes = vec![
        Attribute::new_u32(Semantic::Joints(0), 4, joints),
        Attribute::new_f32(Semantic::Weights(0), 4, [0.25, 0.75, 0.0, 0.0].repeat(8)),
    ];
    let joint =
        |name: &str, parent, y| Joint { name: name.into(), parent, translation: [0.0, y, 0.0], ..Joint::default() };
    let rotation = Keys::Rotation(vec![[0.0, 0.0, 0.0, 1.0], [0.0, 1.0, 0.0, 0.0]]);
    let character = Character {
        mesh,
        skeleton: Skeleton { joints: vec![joint("root", None, 1.0), joint("tip", Some(0), 0.5)] },
        clips: vec![Clip {
            name: "turn".into(),
            channels: vec![Channel {
                joint: 1,
                times: vec![0.0, 1.0],
                interpolation: Interpolation::Linear,
                keys: rotation,
            }],
        }],
        texture_png: Some(b"\x89PNG picture".to_vec()),
    };
    let asset = Asset::from_character("cube", &character);
    assert_eq!(asset.merged_positions().bounds().unwrap(), ([-1.0; 3], [1.0; 3]));
    let again = reread(&asset);
    // at rest the skin changes nothing
    assert_eq!(again.merged_positions().bounds().unwrap(), ([-1.0; 3], [1.0; 3]));
    assert_eq!(again.instances[0].joint_matrices.as_ref().unwrap().len(), 2);
    let (json, _) = split(&written(&asset));
    assert_eq!(json["animations"][0]["channels"][0]["target"], json!({ "node": 2, "path": "rotation" }));
    assert_eq!(json["nodes"][1]["children"], json!([2]));
    assert_eq!(json["skins"][0]["joints"], json!([1, 2]));
}

/// A square on two joints, the second of which is one unit to the right of the first: the left side hangs on the first, the
/// right side on the second.
fn arm() -> File {
    let mut file = File::square();
    file.attribute("JOINTS_0", U8, "VEC4", &[[0, 0, 0, 0], [1, 0, 0, 0], [0, 0, 0, 0], [1, 0, 0, 0]].concat());
    file.attribute("WEIGHTS_0", FLOAT, "VEC4", &floats(&[1.0, 0.0, 0.0, 0.0].repeat(4)));
    let mut inverses = [0.0; 32];
    [0, 5, 10, 15, 16, 21, 26, 31].into_iter().for_each(|i| inverses[i] = 1.0);
    inverses[28] = -1.0;
    let inverses = file.accessor(FLOAT, "MAT4", 2, &floats(&inverses));
    file.json["nodes"] =
        json!([{ "mesh": 0, "skin": 0 }, { "children": [2] }, { "translation": [1, 0, 0], "rotation": [0, 0, 0, 1] }]);
    file.json["scenes"][0]["nodes"] = json!([0, 1]);
    file.json["skins"] = json!([{ "joints": [1, 2], "inverseBindMatrices": inverses }]);
    file
}

/// Unit quaternion of a turn about z, in radians.
fn turn_z(angle: f32) -> [f32; 4] {
    [0.0, 0.0, (angle / 2.0).sin(), (angle / 2.0).cos()]
}

fn points_at(asset: &Asset, seconds: f64) -> Vec<DVec3> {
    let posed = asset.merged_positions_of(&asset.animation(0).instances_at(seconds));
    posed.positions.iter().map(|&p| Vec3::from(p).as_dvec3()).collect()
}

#[track_caller]
fn assert_near(points: &[DVec3], expected: &[DVec3]) {
    assert_eq!(points.len(), expected.len());
    assert!(points.iter().zip(expected).all(|(a, b)| a.distance(*b) < 1e-6), "{points:?}");
}

#[test]
fn an_arm_bends_at_both_joints() {
    use std::f64::consts::FRAC_PI_2;
    let mut file = arm();
    // the shoulder turns by a quarter; the elbow, too, whose keys are given with opposite signs and in 16 bits
    let shoulder = [turn_z(0.0), turn_z(FRAC_PI_2 as f32)].concat();
    let shoulder = file.accessor(FLOAT, "VEC4", 2, &floats(&shoulder));
    file.channel("LINEAR", &[1.0, 3.0], shoulder, 1, "rotation");
    let elbow = [turn_z(0.0), turn_z(FRAC_PI_2 as f32).map(|x| -x)].concat();
    let elbow: Vec<u16> = elbow.iter().map(|x| (x * 32767.0).round() as i16 as u16).collect();
    let elbow = file.accessor(5122, "VEC4", 2, &shorts(&elbow));
    file.json["accessors"][elbow]["normalized"] = json!(true);
    file.channel("LINEAR", &[1.0, 3.0], elbow, 2, "rotation");
    let asset = file.read().unwrap();
    assert_eq!(asset.warnings, [""; 0]);
    assert_eq!((asset.clips().len(), asset.clips()[0].name.as_str()), (1, "clip 0"));
    assert_eq!((asset.clips()[0].start(), asset.clips()[0].end()), (1.0, 3.0));
    for (seconds, share) in [(-1.0, 0.0), (1.0, 0.0), (1.5, 0.25), (2.0, 0.5), (2.9, 0.95), (3.0, 1.0), (50.0, 1.0)] {
        let turn = |angle: f64| DVec3::new(angle.cos(), angle.sin(), 0.0);
        let angle = share * FRAC_PI_2;
        // of the two vertices of each side one stands on its joint, the other a unit above it
        let (elbow, up) = (turn(angle), |angle: f64| turn(angle + FRAC_PI_2));
        let expected = [DVec3::ZERO, elbow, up(angle), elbow + up(2.0 * angle)];
        let points = points_at(&asset, seconds);
        assert!(points.iter().zip(expected).all(|(a, b)| a.distance(b) < 5e-5), "{points:?} at {seconds} s");
    }
    // half the way is exact whatever the keys' rounding
    assert!(points_at(&asset, 2.0)[1].distance(DVec3::new(0.5_f64.sqrt(), 0.5_f64.sqrt(), 0.0)) < 1e-6);
    let again = reread(&touched(asset));
    assert_eq!((again.clips()[0].end(), again.animation(0).instances_at(2.0).len()), (3.0, 1));
}

#[test]
fn every_interpolation_and_property_is_sampled() {
    let mut file = File::square();
    let lift = file.accessor(FLOAT, "VEC3", 4, &floats(&[0.0, 0.0, 4.0].repeat(4)));
    let shift = file.accessor(FLOAT, "VEC3", 4, &floats(&[0.0, 8.0, 0.0].repeat(4)));
    file.primitive()["targets"] = json!([{ "POSITION": lift }, { "POSITION": shift }]);
    file.json["meshes"][0]["weights"] = json!([0.0, 0.5]);
    file.json["nodes"] = json!([{ "mesh": 0, "scale": [1, 2, 1] }]);
    let corner = |asset: &Asset, seconds| points_at(asset, seconds)[3];
    // x = t^3: the tangents at 0 and 2 are 0 and 12
    let cubic = [[0.0; 3], [0.0; 3], [0.0; 3], [12.0, 0.0, 0.0], [8.0, 0.0, 0.0], [12.0, 0.0, 0.0]].concat();
    let cubic = file.accessor(FLOAT, "VEC3", 6, &floats(&cubic));
    file.channel("CUBICSPLINE", &[0.0, 2.0], cubic, 0, "translation");
    assert_eq!(file.read().unwrap().clips()[0].end(), 2.0);
    for t in [0.0, 0.5, 1.0, 1.75, 2.0] {
        let expected = DVec3::new(1.0 + t * t * t, 2.0 * 5.0, 0.0);
        assert!(corner(&file.read().unwrap(), t).distance(expected) < 1e-6);
    }
    // scale in steps; of three keys the middle one is sparse over zeros
    let (indices, value) = (file.view(&[1]), file.view(&floats(&[3.0, 1.0, 1.0])));
    let sparse = json!({ "count": 1, "indices": { "bufferView": indices, "componentType": U8 }, "values": { "bufferView": value } });
    let scales = json!({ "componentType": FLOAT, "count": 3, "type": "VEC3", "sparse": sparse });
    let scales = file.push("accessors", scales);
    file.channel("STEP", &[0.0, 0.5, 1.5], scales, 0, "scale");
    let asset = file.read().unwrap();
    assert_near(&[corner(&asset, 0.25), corner(&asset, 1.0)], &[DVec3::X * 0.015625, DVec3::new(4.0, 5.0, 0.0)]);
    // weights of both targets in eight bits
    let weights = file.accessor(U8, "SCALAR", 4, &[0, 0, 255, 51]);
    file.json["accessors"][weights]["normalized"] = json!(true);
    file.channel("LINEAR", &[0.0, 2.0], weights, 0, "weights");
    let asset = file.read().unwrap();
    assert_eq!(asset.warnings, [""; 0]);
    assert_near(&[corner(&asset, 1.0)], &[DVec3::new(4.0, 1.0 + 0.1 * 8.0, 0.5 * 4.0)]);
    assert_eq!(asset.animation(0).instances_at(2.0)[0].morph_weights, [1.0, 0.2]);
    assert_eq!(asset.instances[0].morph_weights, [0.0, 0.5], "the rest pose stays");
}

#[test]
fn a_node_given_by_a_matrix_moves_in_one_part_of_it() {
    let mut file = File::square();
    file.json["nodes"] =
        json!([{ "children": [1] }, { "mesh": 0, "matrix": [2, 0, 0, 0, 0, 2, 0, 0, 0, 0, 2, 0, 7, 0, 0, 1] }]);
    let turn = file.accessor(FLOAT, "VEC4", 1, &floats(&turn_z(std::f32::consts::PI)));
    file.channel("LINEAR", &[0.0], turn, 1, "rotation");
    assert_near(&points_at(&file.read().unwrap(), 0.0)[3..], &[DVec3::new(5.0, -2.0, 0.0)]);
    // flat, it has no rotation left
    file.json["nodes"][1]["matrix"][0] = json!(0);
    let asset = file.read().unwrap();
    assert!(asset.warnings[0].contains("the matrix of node 1"), "{:?}", asset.warnings);
    assert_near(&points_at(&asset, 0.0)[3..], &[DVec3::new(7.0, 2.0, 0.0)]);
}

#[test]
fn broken_channels_are_left_out_with_a_warning() {
    let animated = || {
        let mut file = arm();
        let turns = [turn_z(0.0), turn_z(1.0)].concat();
        let turns = file.accessor(FLOAT, "VEC4", 2, &floats(&turns));
        file.channel("LINEAR", &[0.0, 1.0], turns, 2, "rotation");
        let moves = file.accessor(FLOAT, "VEC3", 2, &floats(&[0.0, 0.0, 0.0, 0.0, 0.0, 3.0]));
        file.channel("LINEAR", &[0.0, 1.0], moves, 1, "translation");
        file.json["animations"][0]["name"] = json!("wave");
        file
    };
    let (input, output) = {
        let sampler = animated().json["animations"][0]["samplers"][0].clone();
        (sampler["input"].as_u64().unwrap(), sampler["output"].as_u64().unwrap())
    };
    let cases = [
        ("/animations/0/channels/0/sampler".to_owned(), json!(9), "sampler 9 does not exist"),
        ("/animations/0/channels/0/sampler".to_owned(), json!(-1), "channels[0].sampler"),
        ("/animations/0/channels/0/target/node".to_owned(), json!(3), "node 3 does not exist"),
        ("/animations/0/channels/0/target/path".to_owned(), json!("colour"), "unknown path 'colour'"),
        ("/animations/0/channels/0/target/path".to_owned(), json!("weights"), "no morph targets"),
        ("/animations/0/channels/0/target/path".to_owned(), json!("scale"), "samplers[0].output"),
        ("/animations/0/samplers/0/interpolation".to_owned(), json!("BEZIER"), "unknown interpolation 'BEZIER'"),
        ("/animations/0/samplers/0/interpolation".to_owned(), json!("CUBICSPLINE"), "expected 6 of type VEC4"),
        ("/animations/0/samplers/0/input".to_owned(), json!(77), "accessor 77 does not exist"),
        ("/animations/0/samplers/0/input".to_owned(), json!(output), "samplers[0].input"),
        (format!("/accessors/{input}/count"), json!(1), "expected 1 of type VEC4, found 2"),
        (format!("/accessors/{input}/count"), json!(0), "samplers[0].input"),
        (format!("/accessors/{output}/count"), json!(4_000_000_000_u64), "samplers[0].output"),
    ];
    let told = |file: &File, what: &str| {
        let asset = file.read().unwrap_or_else(|error| panic!("{what}: {error}"));
        let warning = asset.warnings.join("\n");
        assert!(warning.contains("'wave'") && warning.contains("animations[0].channels[0]"), "{what}: {warning}");
        // the sound channel still moves
        assert!(points_at(&asset, 0.5).iter().all(|p| (p.z - 1.5).abs() < 1e-6), "{what}");
        warning
    };
    for (pointer, value, expected) in cases {
        let mut file = animated();
        let what = format!("{pointer} = {value}");
        *file.json.pointer_mut(&pointer).unwrap_or(&mut Value::Null) = value;
        let warning = told(&file, &what);
        assert!(warning.contains(expected), "{what}: {warning}");
    }
    for (times, expected) in [([1.0, 0.0], "do not ascend"), ([0.0, f32::NAN], "do not ascend")] {
        let mut file = animated();
        let view = file.json["accessors"][input as usize]["bufferView"].as_u64().unwrap() as usize;
        let start = file.json["bufferViews"][view]["byteOffset"].as_u64().unwrap() as usize;
        file.bytes[start..start + 8].copy_from_slice(&floats(&times));
        assert!(told(&file, "times").contains(expected));
    }
    let mut file = animated();
    file.json["animations"][0]["channels"] = json!("none");
    let asset = file.read().unwrap();
    assert!(asset.warnings[0].contains("expected an array"), "{:?}", asset.warnings);
    assert_eq!((asset.clips()[0].start(), asset.clips()[0].end()), (0.0, 0.0));
    assert_eq!(points_at(&asset, 1.0).len(), 4);
}

#[test]
fn channels_over_the_same_keys_cannot_ask_for_much_memory() {
    let mut file = File::square();
    let keys = file.accessor(FLOAT, "VEC3", 60_000, &vec![0; 720_000]);
    file.channel("LINEAR", &vec![0.0; 60_000], keys, 0, "translation");
    let channel = file.json["animations"][0]["channels"][0].clone();
    file.json["animations"][0]["channels"] = json!(vec![channel; 10_000]);
    let asset = read_bytes(&file.glb(), None, &ReadOptions { max_bytes: 10 << 20 }).unwrap();
    assert!(asset.warnings[0].contains("more memory than allowed"), "{:?}", asset.warnings);
    assert!(asset.clips()[0].channels.len() < 20);
}

#[test]
fn the_sample_character_moves_as_its_skeleton_does() {
    let character = maille::samples::character(4000);
    let asset = reread(&Asset::from_character("someone", &character));
    let names: Vec<&str> = asset.clips().iter().map(|clip| clip.name.as_str()).collect();
    assert_eq!(names, ["walk", "run", "idle"]);
    let inverse_binds = character.skeleton.inverse_bind_matrices();
    for (i, clip) in character.clips.iter().enumerate() {
        let animation = asset.animation(i);
        assert_eq!(asset.clips()[i].end(), clip.end());
        for share in [0.0, 0.13, 0.5, 0.77, 1.0] {
            let seconds = share * clip.end();
            let worlds = character.skeleton.posed(clip, seconds).world_matrices();
            let instances = animation.instances_at(seconds);
            let matrices = instances[0].joint_matrices.as_ref().unwrap();
            for ((matrix, world), inverse) in matrices.iter().zip(&worlds).zip(&inverse_binds) {
                assert!(matrix.abs_diff_eq(*world * *inverse, 1e-6), "{} at {seconds} s", clip.name);
            }
        }
    }
}

#[test]
fn the_same_asset_gives_the_same_bytes() {
    let asset = touched(File::square().read().unwrap());
    assert_eq!(written(&asset), written(&asset.clone()));
    // and what was not touched keeps every byte of its data
    let (json, binary) = split(&written(&File::square().read().unwrap()));
    assert_eq!(
        (json["accessors"].clone(), &binary[..60]),
        (File::square().json["accessors"].clone(), &File::square().bytes[..60])
    );
}
