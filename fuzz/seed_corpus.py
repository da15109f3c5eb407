#!/usr/bin/env python3
"""Makes the small corpus from which the readers are fuzzed: one file for each form of each format. Run it in fuzz/.

Progressive meshes are made by the command `maille`, if it is in the PATH."""

import base64
import json
import shutil
import struct
import subprocess
from pathlib import Path

POINTS = [(0, 0, 0), (1, 0, 0), (1, 1, 0.5), (0, 1, 0)]
FACES = [(0, 1, 2), (0, 2, 3)]


def save(target, name, data):
    folder = Path("corpus") / target
    folder.mkdir(parents=True, exist_ok=True)
    (folder / name).write_bytes(data if isinstance(data, bytes) else data.encode())


def lines(rows):
    return "".join(" ".join(map(str, row)) + "\n" for row in rows)


def ply():
    header = "ply\nformat {} 1.0\ncomment seed\nelement vertex 4\n"
    header += "".join(f"property {t}\n" for t in ("float x", "float y", "float z", "uchar red", "uchar green", "uchar blue"))
    header += "element face 2\nproperty list uchar int vertex_indices\nend_header\n"
    text = lines((*p, 1, 2, 3) for p in POINTS) + lines((3, *f) for f in FACES)
    save("ply", "ascii.ply", header.format("ascii") + text)
    for order, name in (("<", "binary_little_endian"), (">", "binary_big_endian")):
        body = b"".join(struct.pack(order + "3f3B", *p, 1, 2, 3) for p in POINTS)
        body += b"".join(struct.pack(order + "B3i", 3, *f) for f in FACES)
        save("ply", name + ".ply", header.format(name).encode() + body)
    save("ply", "strips.ply", "ply\nformat ascii 1.0\nelement vertex 4\nproperty double x\nproperty double y\n"
         "property double z\nelement tristrips 1\nproperty list int int vertex_indices\nend_header\n"
         + lines(POINTS) + "7 0 1 2 3 -1 0 2\n")
    save("ply", "wedges.ply", "ply\nformat ascii 1.0\nelement vertex 4\nproperty float x\nproperty float y\nproperty float z\n"
         "element face 1\nproperty list uchar int vertex_indices\nproperty list uchar float texcoord\nproperty int texnumber\n"
         "element edge 1\nproperty int vertex1\nproperty int vertex2\nend_header\n"
         + lines(POINTS) + "4 0 1 2 3 8 0 0 1 0 1 1 0 1 0\n0 1\n")


def obj():
    vertices = "".join("v {} {} {}\n".format(*p) for p in POINTS)
    save("obj", "plain.obj", vertices + "f 1 2 3\nf 1 3 4\n")
    save("obj", "all.obj", "mtllib a.mtl\no thing\ng part\n" + vertices.replace("\n", " 1 0.5 0\n")
         + "vt 0 0\nvt 1 1\nvn 0 0 1\nusemtl red\ns 1\nf 1/1/1 2/2/1 \\\n3//1 -1\nl 1 2\nf -4/-1 -3 -2\n")


def stl():
    save("stl", "binary.stl", bytes(80) + struct.pack("<I", 2)
         + b"".join(struct.pack("<12fH", 0, 0, 1, *(x for i in f for x in POINTS[i]), 0x8001) for f in FACES))
    facets = "".join("facet normal 0 0 1\nouter loop\n" + "".join("vertex {} {} {}\n".format(*POINTS[i]) for i in f)
                     + "endloop\nendfacet\n" for f in FACES)
    save("stl", "ascii.stl", "solid seed\n" + facets + "endsolid seed\n")


def off():
    save("off", "plain.off", "OFF\n4 2 0\n" + lines(POINTS) + lines((3, *f, 255, 0, 0) for f in FACES))
    save("off", "all.off", "STCNOFF 4 1 0\n" + lines((*p, 0, 0, 1, 255, 128, 0, 255, 0.5, 0.5) for p in POINTS) + "4 0 1 2 3\n")
    save("off", "binary.off", b"OFF BINARY\n" + struct.pack(">3i", 4, 2, 0) + b"".join(struct.pack(">3f", *p) for p in POINTS)
         + b"".join(struct.pack(">5i", 3, *f, 0) for f in FACES))


def gltf():
    positions = b"".join(struct.pack("<3f", *p) for p in POINTS)
    indices = struct.pack("<6H", *(i for f in FACES for i in f))
    sparse = struct.pack("<HH3f", 2, 0, 0, 0, 1)
    matrices = struct.pack("<16f", *(float(i % 5 == 0) for i in range(16)))
    binary = positions + indices + sparse + bytes(range(16)) + matrices
    ends = [0, 48, 60, 64, 76, 92, 156]
    views = [{"buffer": 0, "byteOffset": a, "byteLength": b - a} for a, b in zip(ends, ends[1:])]
    accessors = [
        {"bufferView": 0, "componentType": 5126, "count": 4, "type": "VEC3"},
        {"bufferView": 1, "componentType": 5123, "count": 6, "type": "SCALAR"},
        {"componentType": 5126, "count": 4, "type": "VEC3", "sparse": {
            "count": 1, "indices": {"bufferView": 2, "componentType": 5123}, "values": {"bufferView": 3}}},
        {"bufferView": 4, "componentType": 5121, "normalized": True, "count": 4, "type": "VEC4"},
        {"bufferView": 5, "componentType": 5126, "count": 1, "type": "MAT4"},
    ]
    attributes = {"POSITION": 0, "COLOR_0": 3, "JOINTS_0": 3, "WEIGHTS_0": 3, "_ID": 3}
    document = {
        "asset": {"version": "2.0"}, "scene": 0, "scenes": [{"nodes": [0, 1]}],
        "nodes": [{"mesh": 0, "skin": 0, "weights": [0.5]}, {"mesh": 0, "children": [2], "scale": [2, 2, 2]},
                  {"mesh": 0, "extensions": {"EXT_mesh_gpu_instancing": {"attributes": {"TRANSLATION": 0}}}}],
        "skins": [{"joints": [1], "inverseBindMatrices": 4}],
        "meshes": [{"primitives": [
            {"attributes": attributes, "indices": 1, "targets": [{"POSITION": 2}]},
            {"attributes": {"POSITION": 0}, "mode": 5}, {"attributes": {"POSITION": 0}, "mode": 0}]}],
        "accessors": accessors, "bufferViews": views,
    }
    uri = "data:application/octet-stream;base64," + base64.b64encode(binary).decode()
    save("gltf", "embedded.gltf", json.dumps({**document, "buffers": [{"byteLength": 156, "uri": uri}]}))
    levels = [{"mesh": 0, "extensions": {"MSFT_lod": {"ids": [1]}}, "extras": {"MSFT_screencoverage": [0.5, 0.01]}},
              {"mesh": 1, "weights": [0.5]}]
    named = {**document["meshes"][0], "extras": {"targetNames": ["geomorph"]}, "weights": [0]}
    chain = {**document, "nodes": levels, "scenes": [{"nodes": [0]}], "skins": [], "meshes": [named, named]}
    for name, json_part in ("all.glb", document), ("levels.glb", chain):
        text = json.dumps({**json_part, "buffers": [{"byteLength": 156}]}).encode()
        text += b" " * (-len(text) % 4)
        body = struct.pack("<I4s", len(text), b"JSON") + text + struct.pack("<I4s", len(binary), b"BIN\0") + binary
        save("gltf", name, struct.pack("<4sII", b"glTF", 2, 12 + len(body)) + body)


def mpm():
    if shutil.which("maille") is None:
        return print("left out: progressive meshes (there is no maille in the PATH)")
    (Path("corpus") / "mpm").mkdir(parents=True, exist_ok=True)
    part = "corpus/mpm/part.ply"
    for arguments in (
        ["sample", "vase", "-o", part], ["simplify", part, "--in-place", "--triangles", "60"],
        ["progressive", part, "-o", "corpus/mpm/part.mpm"],
        ["progressive", "corpus/gltf/all.glb", "-o", "corpus/mpm/all.mpm"],
    ):
        subprocess.run(["maille", *arguments, "--quiet"], check=True)
    Path(part).unlink()


def detect():
    for target in ("gltf", "ply", "obj", "stl", "off", "mpm"):
        first = sorted((Path("corpus") / target).iterdir())[0]
        save("detect", first.name, first.read_bytes())


for make in (gltf, ply, obj, stl, off, mpm, detect):
    make()
