//! From the record of a simplification to numbers by lifetime.

use super::attributes::Attributes;
use super::{CollapseLog, Counts, ProgressiveMesh};
use crate::Control;
use crate::mesh::Mesh;
use crate::simplify::{Record, Recording, SimplifyError, SimplifyOptions, SimplifyReport, Target, simplify_recorded};

const NONE: u32 = u32::MAX;

impl ProgressiveMesh {
    /// Collapses edges of a mesh, down to the target of the options (or as far as they let it, without one), and keeps what
    /// it takes to undo that. The mesh is at its base then.
    ///
    /// Vertices and wedges that no triangle uses are left out, and so are triangles that name a vertex twice. All else of the
    /// options counts as for [`simplify`](crate::simplify::simplify), but for what cannot be undone step by step: vertices
    /// clustered first, normals computed anew in the end, passes.
    ///
    /// # Errors
    /// [`SimplifyError`], as [`simplify`](crate::simplify::simplify) and for the options named above.
    pub fn new(
        mut mesh: Mesh,
        options: &SimplifyOptions,
        control: Control<'_>,
    ) -> Result<(Self, SimplifyReport), SimplifyError> {
        let mut options = options.clone();
        if options.target == Target::default() {
            options.target.triangles = Some(0);
        }
        let (report, (recording, lifted)) = simplify_recorded(&mut mesh, &options, control)?;
        let (mut mesh, log) = control.time("numbering", || numbered(mesh, *recording));
        let attributes = Attributes::take_from(&mut mesh);
        let at = log.errors.len();
        let mut progressive = Self { mesh, attributes, lifted, log, at };
        // numbering has undone what collapses did to corners
        let (base, finest) = (progressive.counts().wedges, progressive.counts_at(0).wedges);
        for wedge in (base..finest).rev() {
            progressive.rename_corners(wedge, progressive.log.wedge_parents[wedge as usize]);
        }
        Ok((progressive, report))
    }
}

/// New numbers of some elements, given in the order of their birth on the way from the base to the finest level.
struct Numbers {
    of: Vec<u32>,
    order: Vec<u32>,
}

impl Numbers {
    fn new(count: usize) -> Self {
        Self { of: vec![NONE; count], order: Vec::new() }
    }

    /// Gives the next number to an element, if it has none.
    fn give(&mut self, element: u32) {
        let number = &mut self.of[element as usize];
        if *number == NONE {
            *number = self.order.len() as u32;
            self.order.push(element);
        }
    }

    /// Gives numbers to some elements in their own order, which is the one in space.
    fn give_all(&mut self, elements: impl Iterator<Item = u32>) {
        let mut elements: Vec<u32> = elements.collect();
        elements.sort_unstable();
        elements.dedup();
        elements.into_iter().for_each(|element| self.give(element));
    }

    fn get(&self, element: u32) -> u32 {
        self.of[element as usize]
    }

    fn count(&self) -> u32 {
        self.order.len() as u32
    }
}

/// Everything by its new number. `mesh` is what [`simplify_recorded`] leaves.
fn numbered(mut mesh: Mesh, recording: Recording) -> (Mesh, CollapseLog) {
    let Recording { collapses, positions, mut triangles, left, faces, corners, changed, rows, vertex_rows } = recording;
    let mut vertices = Numbers::new(positions.len());
    let mut wedges = Numbers::new(mesh.wedge_vertices.len());
    let mut triangle_numbers = Numbers::new(triangles.len());
    // the base: what is left
    let mut merged: Vec<u32> = (0..positions.len() as u32).collect();
    for record in collapses.iter().rev() {
        merged[record.removed as usize] = merged[record.kept as usize];
    }
    left.iter().for_each(|&f| triangle_numbers.give(f));
    wedges.give_all(left.iter().flat_map(|&f| triangles[f as usize]));
    let corners_left = left.iter().flat_map(|&f| triangles[f as usize]);
    let of_base: Vec<u32> = corners_left.map(|w| merged[mesh.wedge_vertices[w as usize] as usize]).collect();
    vertices.give_all(of_base.into_iter());
    // then each split, the last collapse first
    let mut counts = vec![Counts::default(); collapses.len() + 1];
    let mut vertex_parents: Vec<u32> = (0..vertices.count()).collect();
    let mut wedge_parents: Vec<u32> = (0..wedges.count()).collect();
    let mut corner_ends = vec![0_u32; wedges.count() as usize];
    let mut corner_list: Vec<u32> = Vec::with_capacity(corners.len());
    let mut renamed: Vec<(u32, u32, u32)> = Vec::new();
    let count = |vertices: &Numbers, wedges: &Numbers, triangles: &Numbers| Counts {
        vertices: vertices.count(),
        wedges: wedges.count(),
        triangles: triangles.count(),
    };
    counts[collapses.len()] = count(&vertices, &wedges, &triangle_numbers);
    for (step, record) in collapses.iter().enumerate().rev() {
        let before = step.checked_sub(1).map(|before| collapses[before]);
        let of_step = |ends: fn(&Record) -> u32| before.as_ref().map_or(0, ends) as usize..ends(record) as usize;
        let born = &faces[of_step(|record| record.faces_end)];
        // corners go back to wedges that are new now: those are told by what gave them theirs
        renamed.clear();
        renamed.extend_from_slice(&corners[of_step(|record| record.corners_end)]);
        renamed.sort_by_key(|&(_, before, _)| before);
        for of_wedge in renamed.chunk_by(|a, b| a.1 == b.1) {
            let (_, wedge, parent) = of_wedge[0];
            debug_assert_eq!(wedges.get(wedge), NONE, "a wedge that gives corners away gives all");
            wedges.give(wedge);
            wedge_parents.push(wedges.get(parent));
            for &(corner, ..) in of_wedge {
                triangles.as_flattened_mut()[corner as usize] = wedge;
                corner_list.push(triangle_numbers.get(corner / 3) * 3 + corner % 3);
            }
            corner_ends.push(corner_list.len() as u32);
        }
        for &(face, apex) in born {
            triangle_numbers.give(face);
            for wedge in triangles[face as usize] {
                wedges.give(wedge);
            }
            for vertex in [record.kept, apex] {
                vertices.give(vertex);
            }
        }
        vertices.give(record.kept);
        vertices.give(record.removed);
        // those without corners to take over
        (wedge_parents.len() as u32..wedges.count()).for_each(|wedge| wedge_parents.push(wedge));
        corner_ends.resize(wedges.count() as usize, corner_list.len() as u32);
        (vertex_parents.len() as u32..vertices.count() - 1).for_each(|vertex| vertex_parents.push(vertex));
        vertex_parents.push(vertices.get(record.kept));
        counts[step] = count(&vertices, &wedges, &triangle_numbers);
    }
    let has_rows = !rows.0.is_empty();
    let [rows, vertex_rows] = Attributes::tables_of(&mesh, &rows, &vertex_rows);
    let mut highest = [0.0_f32; 2];
    let mut rising = |i: usize, x: f32| {
        highest[i] = highest[i].max(x);
        highest[i]
    };
    let log = CollapseLog {
        followers: (0..).zip(&collapses).filter(|(_, r)| r.cost == f32::NEG_INFINITY).map(|(step, _)| step).collect(),
        errors: collapses.iter().map(|record| rising(0, record.error)).collect(),
        costs: collapses.iter().map(|record| rising(1, record.cost)).collect(),
        positions: collapses.iter().map(|record| record.position).collect(),
        changed_ends: if has_rows { collapses.iter().map(|record| record.changed_end).collect() } else { Vec::new() },
        triangles: counts.iter().map(|counts| counts.triangles).collect(),
        wedges: counts.iter().map(|counts| counts.wedges).collect(),
        vertices: if counts.iter().all(|counts| counts.vertices == counts.wedges) {
            Vec::new()
        } else {
            counts.iter().map(|counts| counts.vertices).collect()
        },
        changed: changed.into_iter().map(|wedge| wedges.get(wedge)).collect(),
        rows,
        vertex_rows,
        vertex_parents,
        wedge_parents,
        corner_ends,
        corners: corner_list,
    };
    mesh.positions = positions;
    mesh.triangles = triangles;
    mesh.gather_triangles(&triangle_numbers.order);
    mesh.gather_wedges(&wedges.order);
    mesh.gather_vertices(&vertices.order);
    mesh.triangles.as_flattened_mut().iter_mut().for_each(|wedge| *wedge = wedges.get(*wedge));
    mesh.wedge_vertices.iter_mut().for_each(|vertex| *vertex = vertices.get(*vertex));
    (mesh, log)
}
