//! Wedges and attributes through collapses (seed 000, 4.1.2 and 4.2.3; Hoppe 1996).

use super::corners::Corners;
use super::driver::Observer;
use super::features::same_value;
use super::legality::Collapse;
use super::options::{NormalPolicy, SimplifyOptions};
use crate::mesh::{Attribute, Mesh, Semantic, Values};
use crate::topology::CollapseMesh;
use crate::topology::collapse_mesh::RingFace;

/// The attributes of a mesh under simplification: those of wedges that become one are blended.
#[derive(Debug)]
pub struct WedgeMerger<'a> {
    corners: Corners,
    /// All but the triangles and positions.
    mesh: Mesh,
    /// Wedges whose normals are to be computed anew at the end; empty when none ever are.
    stale_normals: Vec<bool>,
    options: &'a SimplifyOptions,
}

impl<'a> WedgeMerger<'a> {
    /// Takes over a mesh whose positions are (or will be) in a [`CollapseMesh`]; its own are not looked at.
    pub fn new(mut mesh: Mesh, options: &'a SimplifyOptions) -> Self {
        let recompute = options.normals == NormalPolicy::Recompute && mesh.wedge_attribute(&Semantic::Normal).is_some();
        let corners = Corners::new(std::mem::take(&mut mesh.triangles), &mesh.wedge_vertices);
        let skinned = mesh.wedge_attributes.iter().any(is_skin);
        if let Some(most) = options.max_influences.filter(|_| skinned) {
            (0..mesh.wedge_count() as u32).for_each(|w| limit_influences(&mut mesh.wedge_attributes, w, most));
        }
        Self { corners, stale_normals: vec![false; if recompute { mesh.wedge_count() } else { 0 }], mesh, options }
    }

    /// Whether there is nothing to merge.
    pub(super) fn is_idle(&self) -> bool {
        let mesh = &self.mesh;
        mesh.wedge_attributes.is_empty()
            && mesh.vertex_attributes.is_empty()
            && mesh.morph_targets.is_empty()
            && self.corners.are_plain()
    }

    /// Whether vertices may have several wedges.
    pub(super) fn have_seams(&self) -> bool {
        !self.corners.are_plain()
    }

    /// Whether triangles have materials.
    pub(super) fn have_materials(&self) -> bool {
        !self.mesh.triangle_materials.is_empty()
    }

    /// The material of a triangle.
    pub(super) fn material(&self, triangle: usize) -> u32 {
        self.mesh.triangle_material(triangle)
    }

    /// Whether attributes other than normals and tangents differ between two corners of triangles at the same vertex.
    /// Normals do not count: what is flat-shaded has creases everywhere, and quadrics keep sharp edges by themselves.
    pub(super) fn jump_between(&self, one: (usize, usize), other: (usize, usize)) -> bool {
        if self.corners.are_plain() {
            return false;
        }
        let [v, w] = [one, other].map(|(triangle, corner)| self.corners.of(triangle, [0; 3])[corner]);
        let counts = |a: &&Attribute| !matches!(a.semantic, Semantic::Normal | Semantic::Tangent);
        v != w && !self.mesh.wedge_attributes.iter().filter(counts).all(|a| same_value(a, v, w))
    }

    /// The attributes of the wedges; triangles and positions are elsewhere.
    pub(super) fn mesh(&self) -> &Mesh {
        &self.mesh
    }

    /// The wedge of the corner of a face that lies at a vertex.
    pub(super) fn wedge_at(&self, face: &RingFace, vertex: u32) -> u32 {
        self.corners.at(face, vertex)
    }

    /// The wedge of a corner of a face, `None` where each vertex has one wedge, of its own number.
    pub(super) fn wedge_of_corner(&self, face: u32, corner: u8) -> Option<u32> {
        (!self.corners.are_plain()).then(|| self.corners.of(face as usize, [0; 3])[usize::from(corner)])
    }

    /// The attributes, to be changed from outside.
    pub(super) fn mesh_mut(&mut self) -> &mut Mesh {
        &mut self.mesh
    }

    /// The attributes of all wedges that there were.
    pub(super) fn into_mesh(self) -> Mesh {
        self.mesh
    }

    /// The mesh that is left: all compacted, in the order it had.
    pub fn finish(mut self, faces: CollapseMesh) -> Mesh {
        let live: Vec<u32> = (0..faces.face_count() as u32).filter(|&f| faces.face(f as usize).is_some()).collect();
        if !self.stale_normals.is_empty() {
            self.recompute_normals(&faces, &live);
        }
        let mut mesh = self.mesh;
        let mut wedge_vertices = vec![u32::MAX; mesh.wedge_count()];
        let mut triangles = Vec::with_capacity(live.len());
        for &f in &live {
            let vertices = faces.face(f as usize).expect("only live faces are listed");
            let wedges = self.corners.of(f as usize, vertices);
            for (w, v) in wedges.into_iter().zip(vertices) {
                wedge_vertices[w as usize] = v;
            }
            triangles.push(wedges);
        }
        mesh.triangles = vec![[0; 3]; faces.face_count()];
        mesh.gather_triangles(&live);
        mesh.triangles = triangles;
        mesh.positions = faces.into_positions();
        mesh.wedge_vertices = wedge_vertices;
        compact(&mut mesh);
        mesh
    }

    /// Angle-weighted means of the faces that share each wedge that took part in a collapse.
    fn recompute_normals(&mut self, faces: &CollapseMesh, live: &[u32]) {
        let mut sums = vec![glam::DVec3::ZERO; self.stale_normals.len()];
        for &f in live {
            let vertices = faces.face(f as usize).expect("only live faces are listed");
            let wedges = self.corners.of(f as usize, vertices);
            let p = vertices.map(|v| faces.point(v));
            let normal = (p[1] - p[0]).cross(p[2] - p[0]).normalize_or_zero();
            for k in 0..3 {
                let (to, from) = (p[(k + 1) % 3] - p[k], p[(k + 2) % 3] - p[k]);
                if normal != glam::DVec3::ZERO {
                    sums[wedges[k] as usize] += normal * to.angle_between(from);
                }
            }
        }
        let normals = self.mesh.wedge_attributes.iter_mut().find(|a| a.semantic == Semantic::Normal);
        let Some(values) = normals.and_then(Attribute::as_f32_mut) else { return };
        for (w, sum) in sums.iter().enumerate().filter(|&(w, _)| self.stale_normals[w]) {
            if let Some(normal) = sum.try_normalize() {
                values[3 * w..3 * w + 3].copy_from_slice(&normal.as_vec3().to_array());
            }
        }
    }

    /// Blends into the wedges that no vanishing face joins what has no jump at their vertex: they stay apart from the
    /// merged ones, but only in what makes them differ.
    fn blend_loose_wedges(&mut self, collapse: &Collapse<'_>) {
        if self.corners.are_plain() {
            return;
        }
        let star = &collapse.star;
        let loose = [(star.kept, star.kept_ring), (star.removed, star.removed_ring)].map(|(v, ring)| {
            let wedges = ring.iter().filter(|face| !star.kills(face)).map(|face| self.corners.at(face, v));
            let mut loose: Vec<u32> = wedges.filter(|&w| self.corners.merged(w).is_none()).collect();
            loose.sort_unstable();
            loose.dedup();
            loose
        });
        // those in groups are not blended yet
        for &w in &loose[0] {
            self.blend_loose(w, |(_, b)| [w, b], |(a, _)| a, collapse.t);
        }
        for &w in &loose[1] {
            self.blend_loose(w, |(a, _)| [a, w], |(_, b)| b, collapse.t);
        }
    }

    /// Blends into wedge w the attributes in which it equals, for some pair, the wedge of its own end; `ends` tells
    /// what to blend, given the pair.
    ///
    /// Joints, weights and morphed positions are taken for equal all around a vertex: were they not, the surface would
    /// have cracks once it moves.
    fn blend_loose(&mut self, w: u32, ends: impl Fn((u32, u32)) -> [u32; 2], own: impl Fn((u32, u32)) -> u32, t: f32) {
        let pairs = self.corners.pairs();
        let Some(&any) = pairs.first() else { return };
        let like = |attribute: &Attribute| pairs.iter().find(|&&pair| same_value(attribute, w, own(pair))).copied();
        for attribute in self.mesh.wedge_attributes.iter_mut().filter(|attribute| !is_skin(attribute)) {
            if let Some(pair) = like(attribute) {
                blend(attribute, ends(pair), w, t);
            }
        }
        blend_skin(&mut self.mesh.wedge_attributes, ends(any), w, t, self.options.max_influences);
        for attribute in self.mesh.morph_targets.iter_mut().flat_map(|target| &mut target.attributes) {
            let position = (attribute.semantic == Semantic::Position).then_some(any);
            if let Some(pair) = position.or_else(|| like(attribute)) {
                blend_deltas(attribute, ends(pair), w, t);
            }
        }
    }
}

impl Observer for WedgeMerger<'_> {
    fn on_collapse(&mut self, collapse: &Collapse<'_>) {
        let t = collapse.t;
        for attribute in &mut self.mesh.vertex_attributes {
            blend(attribute, [collapse.star.kept, collapse.star.removed], collapse.star.kept, t);
        }
        if self.mesh.wedge_attributes.is_empty() && self.mesh.morph_targets.is_empty() && self.corners.are_plain() {
            return;
        }
        self.corners.merge(collapse);
        self.blend_loose_wedges(collapse);
        let pairs = self.corners.pairs();
        // one pair of each group gives its values; the others would give the same up to the seam that ends here
        let mut done = 0_u32; // the first pairs, as bits: there are hardly ever more than two
        for (i, &(a, b)) in pairs.iter().enumerate() {
            let into = self.corners.merged(a).expect("wedges of pairs have groups");
            if (0..i.min(32)).any(|j| done >> j & 1 == 1 && self.corners.merged(pairs[j].0) == Some(into)) {
                continue;
            }
            done |= 1_u32.checked_shl(i as u32).unwrap_or(0);
            blend_all(&mut self.mesh.wedge_attributes, [a, b], into, t, self.options.max_influences);
            for attribute in self.mesh.morph_targets.iter_mut().flat_map(|target| &mut target.attributes) {
                blend_deltas(attribute, [a, b], into, t);
            }
            if let Some(stale) = self.stale_normals.get_mut(into as usize) {
                *stale = true;
            }
        }
        for face in collapse.star.kept_ring.iter().chain(collapse.star.removed_ring) {
            if self.stale_normals.is_empty() {
                break;
            }
            for w in self.corners.of(face.face as usize, [collapse.star.kept, face.x, face.y]) {
                self.stale_normals[w as usize] = true;
            }
        }
    }
}

/// Drops vertices and wedges that no triangle uses; the rest keeps its order.
fn compact(mesh: &mut Mesh) {
    let mut used_wedges = vec![false; mesh.wedge_vertices.len()];
    for &w in mesh.triangles.iter().flatten() {
        used_wedges[w as usize] = true;
    }
    let mut used_vertices = vec![false; mesh.positions.len()];
    for (w, _) in used_wedges.iter().enumerate().filter(|(_, used)| **used) {
        used_vertices[mesh.wedge_vertices[w] as usize] = true;
    }
    let (wedges, wedge_names) = kept(&used_wedges);
    let (vertices, vertex_names) = kept(&used_vertices);
    mesh.gather_wedges(&wedges);
    mesh.gather_vertices(&vertices);
    for w in mesh.triangles.iter_mut().flatten() {
        *w = wedge_names[*w as usize];
    }
    for v in &mut mesh.wedge_vertices {
        *v = vertex_names[*v as usize];
    }
}

/// The indices of what is used, and the new index of each.
fn kept(used: &[bool]) -> (Vec<u32>, Vec<u32>) {
    let mut indices = Vec::new();
    let names = used.iter().enumerate().map(|(i, &used)| {
        if used {
            indices.push(i as u32);
        }
        indices.len() as u32 - u32::from(used)
    });
    let names = names.collect();
    (indices, names)
}

/// Blends all attributes of wedges a (t = 0) and b (t = 1) into a wedge.
fn blend_all(attributes: &mut [Attribute], ends: [u32; 2], into: u32, t: f32, max_influences: Option<u32>) {
    let mut skinned = false;
    for attribute in attributes.iter_mut() {
        if is_skin(attribute) {
            skinned = true;
        } else {
            blend(attribute, ends, into, t);
        }
    }
    if skinned {
        blend_skin(attributes, ends, into, t, max_influences);
    }
}

/// Whether an attribute is one of those that move a wedge, in the form that the vocabulary asks for.
fn is_skin(attribute: &Attribute) -> bool {
    let fits = match attribute.semantic {
        Semantic::Joints(_) => attribute.as_u32().is_some(),
        Semantic::Weights(_) => attribute.as_f32().is_some(),
        _ => false,
    };
    fits && attribute.components == 4
}

fn blend(attribute: &mut Attribute, ends: [u32; 2], into: u32, t: f32) {
    let n = attribute.components;
    let from = ends[usize::from(t > 0.5)] as usize * n;
    let nearer = match (&attribute.semantic, attribute.as_f32()) {
        (Semantic::Normal | Semantic::Tangent, Some(values)) if n >= 3 && t > 0.0 && t < 1.0 => {
            let sign = if n > 3 { values[from + 3] } else { 0.0 };
            Some((glam::Vec3::from_slice(&values[from..]), sign))
        }
        _ => None,
    };
    blend_deltas(attribute, ends, into, t);
    let (Some((nearer, sign)), Some(values)) = (nearer, attribute.as_f32_mut()) else { return };
    let v = &mut values[into as usize * n..][..n];
    // what cancels out has no direction: the nearer end gives its own
    let direction = glam::Vec3::from_slice(v).try_normalize().unwrap_or(nearer);
    v[..3].copy_from_slice(&direction.to_array());
    if n > 3 {
        v[3] = sign;
    }
}

fn blend_deltas(attribute: &mut Attribute, [a, b]: [u32; 2], into: u32, t: f32) {
    let n = attribute.components;
    let (a, b, into) = (a as usize * n, b as usize * n, into as usize * n);
    match &mut attribute.values {
        Values::F32(values) => {
            for k in 0..n {
                // exact at both ends, so that a wedge that stays keeps its bits
                values[into + k] = match t {
                    0.0 => values[a + k],
                    1.0 => values[b + k],
                    _ => (1.0 - t) * values[a + k] + t * values[b + k],
                };
            }
        }
        Values::U32(values) => {
            let from = if t <= 0.5 { a } else { b };
            values.copy_within(from..from + n, into);
        }
    }
}

/// Joints and weights over all sets: the weights of both ends are blended joint by joint, the largest kept, and the sum
/// made 1. At an end they are the end's, to the bit.
fn blend_skin(attributes: &mut [Attribute], ends: [u32; 2], into: u32, t: f32, max_influences: Option<u32>) {
    if t > 0.0 && t < 1.0 {
        return mix_influences(attributes, [(ends[0], 1.0 - t), (ends[1], t)], into, max_influences);
    }
    for attribute in attributes.iter_mut().filter(|attribute| is_skin(attribute)) {
        blend_deltas(attribute, ends, into, t);
    }
}

/// Drops the least influences on a wedge that has more than it may have.
fn limit_influences(attributes: &mut [Attribute], wedge: u32, most: u32) {
    let at = wedge as usize * 4..wedge as usize * 4 + 4;
    let skin = attributes.iter().filter(|attribute| is_skin(attribute));
    let count = skin.filter_map(Attribute::as_f32).flat_map(|x| &x[at.clone()]).filter(|x| **x > 0.0).count();
    if count > most as usize {
        mix_influences(attributes, [(wedge, 1.0), (wedge, 0.0)], wedge, Some(most));
    }
}

/// The influences on some wedges, each counted by a share.
fn mix_influences(attributes: &mut [Attribute], shares: [(u32, f32); 2], into: u32, max_influences: Option<u32>) {
    let mut influences: Vec<(u32, f32)> = Vec::new();
    let mut slots = 0;
    let sets = || (0..).map(|set| [Semantic::Joints(set), Semantic::Weights(set)]);
    let place = |attributes: &[Attribute], semantic: &Semantic| {
        attributes.iter().position(|x| is_skin(x) && x.semantic == *semantic)
    };
    for [joints, weights] in sets() {
        let (Some(j), Some(w)) = (place(attributes, &joints), place(attributes, &weights)) else { break };
        let (Some(joints), Some(weights)) = (attributes[j].as_u32(), attributes[w].as_f32()) else { break };
        slots += 4;
        for (end, share) in shares {
            for k in end as usize * 4..end as usize * 4 + 4 {
                let (joint, weight) = (joints[k], weights[k] * share);
                if weight > 0.0 {
                    match influences.iter_mut().find(|(known, _)| *known == joint) {
                        Some((_, sum)) => *sum += weight,
                        None => influences.push((joint, weight)),
                    }
                }
            }
        }
    }
    influences.sort_by(|x, y| y.1.total_cmp(&x.1).then(x.0.cmp(&y.0)));
    influences.truncate(max_influences.map_or(slots, |most| slots.min(most as usize)));
    let total: f32 = influences.iter().map(|(_, weight)| weight).sum();
    if total <= 0.0 {
        return;
    }
    influences.resize(slots, (0, 0.0));
    for (set, four) in influences.chunks(4).enumerate() {
        let at = into as usize * 4;
        for (k, &(joint, weight)) in four.iter().enumerate() {
            for attribute in attributes.iter_mut().filter(|attribute| is_skin(attribute)) {
                match (&attribute.semantic, &mut attribute.values) {
                    (Semantic::Joints(n), Values::U32(values)) if *n as usize == set => values[at + k] = joint,
                    (Semantic::Weights(n), Values::F32(values)) if *n as usize == set => {
                        values[at + k] = weight / total;
                    }
                    _ => {}
                }
            }
        }
    }
}
