//! Edges and vertices to be preserved: open borders, seams, material borders, locks.

use super::metric::Anchor;
use super::options::{EdgePolicy, SimplifyOptions};
use super::wedges::WedgeMerger;
use crate::mesh::{Attribute, Values};
use crate::topology::CollapseMesh;
use crate::topology::collapse_mesh::CollapseEffect;

/// Open border, or an edge of three faces and more.
const BORDER: u8 = 1;
/// The texture coordinates, the colour or another wedge attribute jump here ([`WedgeMerger::jump_between`]).
const SEAM: u8 = 2;
/// Between two materials.
const MATERIAL: u8 = 4;

/// No edge of the surface, but two vertices to be joined.
const PAIR: u8 = 8;

/// What a vertex is to the features around it; a merged vertex is the higher of its two.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
enum Kind {
    /// No feature touches it.
    Regular,
    /// Only features touch it that are held by constraint planes alone.
    Held,
    /// Inside a curve of open border.
    OnBorder,
    /// Inside a curve of seams or material borders.
    OnSeam,
    /// Where curves end, meet or cross: it stays, others may merge into it.
    Corner,
    /// It stays by the user's wish.
    Locked,
}

/// Why an edge may not collapse.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Barred {
    /// Both ends are locked.
    Locked,
    /// A border, seam or material border would be torn, crossed or pinched.
    Feature,
}

/// Which edges of a mesh are to be preserved, kept up to date through collapses.
#[derive(Debug, Default)]
pub struct Features {
    /// Flags of each edge; empty when there are no features.
    edges: Vec<u8>,
    /// Kind of each vertex; empty when there are no features and no locks.
    vertices: Vec<Kind>,
    /// Whether constraint planes hold the borders, so that a placement may weigh them against the surface.
    planes_hold_borders: bool,
}

impl Features {
    /// Finds the features of a mesh that the options want preserved or locked. `faces` has the edges, `wedges` what may
    /// jump at them.
    pub fn new(wedges: &WedgeMerger<'_>, faces: &CollapseMesh, options: &SimplifyOptions) -> Self {
        let flags = edge_flags(wedges, faces, options);
        let any = flags.iter().any(|&f| f != 0);
        if !any && !options.locked.contains(&true) {
            return Self::default();
        }
        let vertices = vertex_kinds(faces, &flags, options);
        let planes = super::constraint_weight(options);
        Self {
            edges: if any { flags } else { Vec::new() },
            vertices,
            planes_hold_borders: planes.is_some_and(|weight| weight > 0.0),
        }
    }

    /// Whether an edge is a feature.
    #[inline]
    pub fn is_feature(&self, edge: u32) -> bool {
        self.edges.get(edge as usize).is_some_and(|&flags| flags & !PAIR != 0)
    }

    /// Whether a vertex has to stay.
    #[inline]
    pub fn is_locked(&self, vertex: u32) -> bool {
        self.vertices.get(vertex as usize) == Some(&Kind::Locked)
    }

    fn is_pair(&self, edge: u32) -> bool {
        self.edges.get(edge as usize).is_some_and(|&flags| flags & PAIR != 0)
    }

    /// Whether a vertex is on a feature or locked.
    #[inline]
    pub fn touches(&self, vertex: u32) -> bool {
        self.vertices.get(vertex as usize).is_some_and(|&kind| kind != Kind::Regular)
    }

    /// Where the merged vertex of an edge may go.
    #[inline]
    pub fn anchor(&self, edge: u32, [a, b]: [u32; 2]) -> Result<Anchor, Barred> {
        if self.vertices.is_empty() {
            return Ok(Anchor::Free);
        }
        let (ka, kb) = (self.vertices[a as usize], self.vertices[b as usize]);
        if ka <= Kind::Held && kb <= Kind::Held {
            return Ok(Anchor::Free);
        }
        let along = self.is_feature(edge);
        let (low, high) = (ka.min(kb), ka.max(kb));
        let higher = if ka > kb { Anchor::First } else { Anchor::Second };
        match (low, high) {
            (Kind::Locked, Kind::Locked) => Err(Barred::Locked),
            // joining crosses borders: that is what it is for
            _ if self.is_pair(edge) => Ok(if ka == kb && ka < Kind::Corner { Anchor::Free } else { higher }),
            (Kind::Corner, _) => Err(Barred::Feature),
            (Kind::Regular | Kind::Held, Kind::OnBorder) if self.planes_hold_borders => Ok(Anchor::Free),
            (Kind::Regular | Kind::Held, _) => Ok(higher),
            _ if !along => Err(Barred::Feature),
            (_, Kind::Corner | Kind::Locked) => Ok(higher),
            _ if ka == kb => Ok(Anchor::Free),
            _ => Err(Barred::Feature),
        }
    }

    /// A collapse has merged `removed` into `kept`.
    pub fn commit(&mut self, kept: u32, removed: u32, effect: &CollapseEffect) {
        if !self.vertices.is_empty() {
            let merged = self.vertices[kept as usize].max(self.vertices[removed as usize]);
            self.vertices[kept as usize] = merged;
        }
        if !self.edges.is_empty() {
            for &(gone, into) in &effect.merged_edges {
                self.edges[into as usize] |= self.edges[gone as usize];
            }
        }
    }
}

fn edge_flags(wedges: &WedgeMerger<'_>, faces: &CollapseMesh, options: &SimplifyOptions) -> Vec<u8> {
    let wanted = |policy: EdgePolicy, flag: u8| if policy == EdgePolicy::Free { 0 } else { flag };
    let border = wanted(options.boundary, BORDER);
    let seam = if wedges.have_seams() { wanted(options.seams, SEAM) } else { 0 };
    let material = if wedges.have_materials() { wanted(options.material_borders, MATERIAL) } else { 0 };
    let mut flags = vec![PAIR; faces.edge_count()];
    let mut count = vec![0_u8; if border != 0 { faces.edge_count() } else { 0 }];
    let mut first = vec![u32::MAX; if seam | material != 0 { faces.edge_count() } else { 0 }];
    for face in 0..faces.face_count() {
        let Some(edges) = faces.face_edges(face) else { continue };
        for (k, edge) in edges.into_iter().enumerate().map(|(k, edge)| (k, edge as usize)) {
            flags[edge] &= !PAIR;
            if border != 0 {
                count[edge] = count[edge].saturating_add(1);
            }
            if seam | material == 0 {
                continue;
            }
            let other = std::mem::replace(&mut first[edge], (face * 4 + k) as u32);
            if other == u32::MAX {
                continue;
            }
            let (other, j) = ((other / 4) as usize, (other % 4) as usize);
            if material != 0 && wedges.material(face) != wedges.material(other) {
                flags[edge] |= material;
            }
            if seam != 0 && jumps(wedges, faces, (face, k), (other, j)) {
                flags[edge] |= seam;
            }
        }
    }
    for (flags, &count) in flags.iter_mut().zip(&count) {
        if count != 2 && count != 0 {
            *flags |= border;
        }
    }
    flags
}

/// Whether wedge attributes other than normals and tangents differ across the edge opposite to corner k of one
/// triangle and corner j of another.
fn jumps(wedges: &WedgeMerger<'_>, faces: &CollapseMesh, (one, k): (usize, usize), (other, j): (usize, usize)) -> bool {
    let (Some(s), Some(t)) = (faces.face(one), faces.face(other)) else { return false };
    [(k + 1) % 3, (k + 2) % 3].into_iter().any(|near| {
        let far = [(j + 1) % 3, (j + 2) % 3].into_iter().find(|&far| t[far] == s[near]);
        far.is_some_and(|far| wedges.jump_between((one, near), (other, far)))
    })
}

/// Whether two elements of an attribute are equal.
pub(super) fn same_value(attribute: &Attribute, v: u32, w: u32) -> bool {
    let range = |w: u32| w as usize * attribute.components..(w as usize + 1) * attribute.components;
    match &attribute.values {
        Values::F32(x) => x[range(v)] == x[range(w)],
        Values::U32(x) => x[range(v)] == x[range(w)],
    }
}

fn vertex_kinds(faces: &CollapseMesh, flags: &[u8], options: &SimplifyOptions) -> Vec<Kind> {
    /// Edges of a vertex by sort, as far as counting needs to go.
    #[derive(Clone, Copy, Default)]
    struct Counts {
        border: u8,
        seam: u8,
        lock: bool,
        held: bool,
    }
    let mut counts = vec![Counts::default(); faces.vertex_count()];
    let locks = [(options.boundary, BORDER), (options.seams, SEAM), (options.material_borders, MATERIAL)];
    let with = |wanted| locks.iter().filter(|(policy, _)| *policy == wanted).fold(0, |all, (_, flag)| all | flag);
    let (locking, holding) = (with(EdgePolicy::Lock), with(EdgePolicy::Hold));
    for (edge, &flags) in flags.iter().enumerate().filter(|&(_, &flags)| flags != 0) {
        for v in faces.ends(edge as u32) {
            let at = &mut counts[v as usize];
            at.held |= flags & holding != 0;
            let flags = flags & !holding;
            at.border = at.border.saturating_add(u8::from(flags & BORDER != 0));
            at.seam = at.seam.saturating_add(u8::from(flags & (SEAM | MATERIAL) != 0));
            at.lock |= flags & locking != 0;
        }
    }
    let kind = |(v, at): (usize, &Counts)| match (at.border, at.seam) {
        _ if at.lock || options.locked.get(v).copied().unwrap_or(false) => Kind::Locked,
        (0, 0) if at.held => Kind::Held,
        (0, 0) => Kind::Regular,
        (2, 0) => Kind::OnBorder,
        (0, 2) => Kind::OnSeam,
        _ => Kind::Corner,
    };
    counts.iter().enumerate().map(kind).collect()
}
