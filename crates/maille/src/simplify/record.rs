//! Collapses as they are made, written down so that they can be undone.

use super::driver::Observer;
use super::legality::Collapse;
use super::wedges::WedgeMerger;
use crate::mesh::{Attribute, Mesh, Values};

/// Merges wedges as a [`WedgeMerger`] does, and writes down what each collapse has changed, if that is asked for.
#[derive(Debug)]
pub(super) struct Recorder<'a> {
    pub(super) wedges: WedgeMerger<'a>,
    recording: Option<Box<Recording>>,
    around: Around,
}

/// The wedges around the collapse that is being made, as they were before.
#[derive(Debug, Default)]
struct Around {
    /// The faces that stay, their corner there, and the wedge of that.
    corners: Vec<(u32, u8, u32)>,
    wedges: Vec<u32>,
    rows: Rows,
}

/// All collapses of a mesh, and the mesh as they have left it.
#[derive(Debug, Default)]
pub(crate) struct Recording {
    pub(crate) collapses: Vec<Record>,
    /// Where the vertices are now; those that have merged as they were last.
    pub(crate) positions: Vec<[f32; 3]>,
    /// Triangles over wedges; those that have vanished as they were last. Those that never counted (a vertex twice) are
    /// neither among the faces left nor among those taken away.
    pub(crate) triangles: Vec<[u32; 3]>,
    /// The faces that are left.
    pub(crate) left: Vec<u32>,
    /// The faces that each collapse takes away, one after the other, and the vertex of each that is not on the edge.
    pub(crate) faces: Vec<(u32, u32)>,
    /// The corners whose wedge changes: three times the face and the corner, the wedge before and after.
    pub(crate) corners: Vec<(u32, u32, u32)>,
    /// The wedges whose attributes change, and what they were before.
    pub(crate) changed: Vec<u32>,
    pub(crate) rows: Rows,
    /// Attributes of the vertices that stay, as they were before each collapse.
    pub(crate) vertex_rows: Rows,
}

/// A collapse; where it ends in the lists of the [`Recording`].
#[derive(Debug, Clone, Copy)]
pub(crate) struct Record {
    pub(crate) kept: u32,
    pub(crate) removed: u32,
    /// Where the vertex that stays was before.
    pub(crate) position: [f32; 3],
    pub(crate) error: f32,
    pub(crate) cost: f32,
    pub(crate) faces_end: u32,
    pub(crate) corners_end: u32,
    pub(crate) changed_end: u32,
}

/// Values of all attributes of some elements, one after the other, to each attribute.
#[derive(Debug, Clone, Default, PartialEq)]
pub(crate) struct Rows(pub(crate) Vec<Values>);

impl Rows {
    /// No elements yet, of some attributes.
    pub(crate) fn none_of<'m>(attributes: impl Iterator<Item = &'m Attribute>) -> Self {
        let empty = |attribute: &Attribute| match attribute.values {
            Values::F32(_) => Values::F32(Vec::new()),
            Values::U32(_) => Values::U32(Vec::new()),
        };
        Self(attributes.map(empty).collect())
    }

    fn clear(&mut self) {
        for values in &mut self.0 {
            match values {
                Values::F32(values) => values.clear(),
                Values::U32(values) => values.clear(),
            }
        }
    }

    /// Adds an element.
    fn push<'m>(&mut self, attributes: impl Iterator<Item = &'m Attribute>, element: u32) {
        for (into, from) in self.0.iter_mut().zip(attributes) {
            let range = element as usize * from.components..(element as usize + 1) * from.components;
            match (into, &from.values) {
                (Values::F32(into), Values::F32(from)) => into.extend_from_slice(&from[range]),
                (Values::U32(into), Values::U32(from)) => into.extend_from_slice(&from[range]),
                _ => unreachable!("rows are made for their attributes"),
            }
        }
    }

    /// Adds an element of others.
    fn push_row<'m>(&mut self, attributes: impl Iterator<Item = &'m Attribute>, others: &Self, row: usize) {
        for ((into, from), attribute) in self.0.iter_mut().zip(&others.0).zip(attributes) {
            let range = row * attribute.components..(row + 1) * attribute.components;
            match (into, from) {
                (Values::F32(into), Values::F32(from)) => into.extend_from_slice(&from[range]),
                (Values::U32(into), Values::U32(from)) => into.extend_from_slice(&from[range]),
                _ => unreachable!("rows are made for their attributes"),
            }
        }
    }

    /// Whether an element is, to the bit, what a row says.
    fn holds<'m>(&self, row: usize, mut attributes: impl Iterator<Item = &'m Attribute>, element: u32) -> bool {
        let mut own = self.0.iter();
        attributes.all(|attribute| {
            let n = attribute.components;
            let (ours, theirs) = (row * n..(row + 1) * n, element as usize * n..(element as usize + 1) * n);
            match (own.next(), &attribute.values) {
                (Some(Values::F32(a)), Values::F32(b)) => {
                    a[ours].iter().zip(&b[theirs]).all(|(a, b)| a.to_bits() == b.to_bits())
                }
                (Some(Values::U32(a)), Values::U32(b)) => a[ours] == b[theirs],
                _ => unreachable!("rows are made for their attributes"),
            }
        })
    }
}

/// The attributes of wedges, those of morph targets among them.
pub(crate) fn attributes_of_wedges(mesh: &Mesh) -> impl Iterator<Item = &Attribute> {
    mesh.wedge_attributes.iter().chain(mesh.morph_targets.iter().flat_map(|target| &target.attributes))
}

/// As [`attributes_of_wedges`], to be changed.
pub(crate) fn attributes_of_wedges_mut(mesh: &mut Mesh) -> impl Iterator<Item = &mut Attribute> {
    mesh.wedge_attributes.iter_mut().chain(mesh.morph_targets.iter_mut().flat_map(|target| &mut target.attributes))
}

impl<'a> Recorder<'a> {
    /// Records nothing.
    pub(super) fn idle(wedges: WedgeMerger<'a>) -> Self {
        Self { wedges, recording: None, around: Around::default() }
    }

    /// Records all. `triangles` are over wedges.
    pub(super) fn new(wedges: WedgeMerger<'a>, positions: Vec<[f32; 3]>, triangles: Vec<[u32; 3]>) -> Self {
        let rows = Rows::none_of(attributes_of_wedges(wedges.mesh()));
        let vertex_rows = Rows::none_of(wedges.mesh().vertex_attributes.iter());
        let around = Around { rows: rows.clone(), ..Around::default() };
        let recording = Recording { positions, triangles, rows, vertex_rows, ..Recording::default() };
        Self { wedges, recording: Some(Box::new(recording)), around }
    }

    /// What has been recorded, and what merged.
    pub(super) fn into_parts(self) -> (WedgeMerger<'a>, Option<Box<Recording>>) {
        (self.wedges, self.recording)
    }
}

impl Around {
    fn look(&mut self, collapse: &Collapse<'_>, wedges: &WedgeMerger<'_>) {
        self.corners.clear();
        self.wedges.clear();
        self.rows.clear();
        let star = &collapse.star;
        for (ring, vertex) in [(star.kept_ring, star.kept), (star.removed_ring, star.removed)] {
            for face in ring {
                let wedge = wedges.wedge_at(face, vertex);
                self.wedges.push(wedge);
                if !star.kills(face) {
                    self.corners.push((face.face, face.corner, wedge));
                }
            }
        }
        self.wedges.sort_unstable();
        self.wedges.dedup();
        for &wedge in &self.wedges {
            self.rows.push(attributes_of_wedges(wedges.mesh()), wedge);
        }
    }
}

impl Observer for Recorder<'_> {
    fn on_collapse(&mut self, collapse: &Collapse<'_>) {
        let Some(recording) = &mut self.recording else { return self.wedges.on_collapse(collapse) };
        let star = &collapse.star;
        self.around.look(collapse, &self.wedges);
        recording.vertex_rows.push(self.wedges.mesh().vertex_attributes.iter(), star.kept);
        self.wedges.on_collapse(collapse);
        let killed = star.kept_ring.iter().filter(|face| star.kills(face));
        recording.faces.extend(killed.map(|face| (face.face, if face.x == star.removed { face.y } else { face.x })));
        for &(face, corner, before) in &self.around.corners {
            let after = self.wedges.wedge_of_corner(face, corner).unwrap_or(star.kept);
            if after != before {
                recording.corners.push((3 * face + u32::from(corner), before, after));
                recording.triangles[face as usize][usize::from(corner)] = after;
            }
        }
        let position = &mut recording.positions[star.kept as usize];
        recording.collapses.push(Record {
            kept: star.kept,
            removed: star.removed,
            position: std::mem::replace(position, collapse.position),
            error: collapse.error as f32,
            cost: collapse.cost as f32,
            faces_end: recording.faces.len() as u32,
            corners_end: recording.corners.len() as u32,
            changed_end: 0,
        });
    }

    fn on_values(&mut self, give: &mut dyn FnMut(&[u32], &mut Mesh)) {
        let Some(recording) = &mut self.recording else { return };
        give(&self.around.wedges, self.wedges.mesh_mut());
        for (row, &wedge) in self.around.wedges.iter().enumerate() {
            let mesh = self.wedges.mesh();
            if !self.around.rows.holds(row, attributes_of_wedges(mesh), wedge) {
                recording.changed.push(wedge);
                recording.rows.push_row(attributes_of_wedges(mesh), &self.around.rows, row);
            }
        }
        if let Some(last) = recording.collapses.last_mut() {
            last.changed_end = recording.changed.len() as u32;
        }
    }
}
