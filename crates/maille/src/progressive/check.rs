//! Whether a progressive mesh that was read holds what moving between its levels relies on.

use super::bytes::DecodeError;
use super::{AHEAD, Counts, ProgressiveMesh, range_of};
use crate::topology::UnionFind;

/// Nothing at all, or a number that is beyond all others.
const NONE: u32 = u32::MAX;

type Checked = Result<(), DecodeError>;

fn require(holds: bool, what: &'static str) -> Checked {
    if holds { Ok(()) } else { Err(DecodeError::Log(what)) }
}

fn require_at(holds: bool, collapse: usize, what: &'static str) -> Checked {
    if holds { Ok(()) } else { Err(DecodeError::Collapse { collapse, what }) }
}

impl ProgressiveMesh {
    /// Looks at all that levels are made of, once the lengths of all arrays agree: afterwards every level refers to its own
    /// elements alone, and any way from one to another can be gone back. Begins at the base and ends at the finest level.
    pub(super) fn check(&mut self) -> Checked {
        self.check_numbers()?;
        self.check_lifted()?;
        self.check_wedges_of_vertices()?;
        self.check_splits()
    }

    /// What each array must hold by itself.
    fn check_numbers(&self) -> Checked {
        self.mesh.check()?;
        let (log, collapses) = (&self.log, self.collapse_count());
        let is_finite = |points: &[[f32; 3]]| points.as_flattened().iter().all(|x| x.is_finite());
        require(is_finite(&self.mesh.positions) && is_finite(&log.positions), "a position is not finite")?;
        for values in [&log.errors, &log.costs] {
            require(values.iter().all(|x| !x.is_nan()) && values.is_sorted(), "errors or costs that do not rise")?;
        }
        let within = log.followers.iter().all(|&step| step > 0 && (step as usize) < collapses);
        require(within && log.followers.is_sorted_by(|a, b| a < b), "the list of followers is not one of collapses")?;
        for parents in [&log.vertex_parents, &log.wedge_parents] {
            require((0..).zip(parents).all(|(i, &parent)| parent <= i), "a parent is younger than its child")?;
        }
        require(log.corner_ends.is_sorted() && log.changed_ends.is_sorted(), "ends that do not rise")?;
        let corners = 3 * self.mesh.triangle_count();
        require(log.corners.iter().all(|&corner| (corner as usize) < corners), "a corner that does not exist")?;
        for collapse in 0..collapses {
            let [finer, coarser] = [collapse, collapse + 1].map(|at| log.counts(at));
            let falls = finer.vertices > coarser.vertices
                && finer.wedges >= coarser.wedges
                && finer.triangles >= coarser.triangles;
            require_at(falls, collapse, "it does not make the mesh smaller")?;
        }
        Ok(())
    }

    /// Attributes of wedges that become those of vertices have places among these.
    fn check_lifted(&self) -> Checked {
        let places = &self.lifted.0;
        require(places.len() <= self.attributes.wedges.len(), "more lifted attributes than attributes of wedges")?;
        let others = self.attributes.vertices.len();
        let fits = places.iter().rev().enumerate().all(|(k, &place)| place <= others + k);
        require(fits, "a lifted attribute without a place")
    }

    /// Each wedge of a level is at a vertex of the level, and each vertex has a wedge: followed from the finest level to the
    /// base.
    fn check_wedges_of_vertices(&self) -> Checked {
        const AWAY: &str = "a wedge outlives its vertex";
        const BARE: &str = "a vertex outlives its wedges";
        let (log, vertex_of) = (&self.log, &self.mesh.wedge_vertices);
        let roots = self.followed(&log.vertex_parents, 0);
        let is_at_vertex = |wedge: u32, level: Counts| roots[vertex_of[wedge as usize] as usize] < level.vertices;
        // of each vertex its wedge of the lowest number, which is the last one to go
        let mut lowest = vec![NONE; self.mesh.vertex_count()];
        for (wedge, &vertex) in vertex_of.iter().enumerate().rev() {
            lowest[vertex as usize] = wedge as u32;
        }
        require(!lowest.contains(&NONE), "a vertex without a wedge")?;
        let mut merged = UnionFind::new(lowest.len());
        for collapse in 0..self.collapse_count() {
            let [finer, coarser] = [collapse, collapse + 1].map(|at| log.counts(at));
            for vertex in (coarser.vertices..finer.vertices).rev() {
                let parent = log.vertex_parents[vertex as usize];
                merged.union(vertex, parent);
                lowest[parent as usize] = lowest[parent as usize].min(lowest[vertex as usize]);
            }
            for wedge in coarser.wedges..finer.wedges {
                require_at(is_at_vertex(wedge, finer), collapse, AWAY)?;
                let vertex = merged.find(vertex_of[wedge as usize]);
                let is_last = vertex < coarser.vertices && lowest[vertex as usize] == wedge;
                require_at(!is_last, collapse, BARE)?;
            }
        }
        let base = log.counts(self.collapse_count());
        require((0..base.wedges).all(|wedge| is_at_vertex(wedge, base)), AWAY)
    }

    /// Goes from the base to the finest level. Every split finds the corners as its collapse leaves them, so that the one
    /// undoes the other, and what comes up refers to what is there.
    fn check_splits(&mut self) -> Checked {
        let base = self.counts();
        require(self.are_below(0..base.triangles, base.wedges), "a triangle of the base has a wedge that comes later")?;
        let mut last_change = vec![NONE; if self.log.changed_ends.is_empty() { 0 } else { self.mesh.wedge_count() }];
        for collapse in (0..self.collapse_count()).rev() {
            let [finer, coarser] = [collapse, collapse + 1].map(|at| self.log.counts(at));
            if let Some(later) = collapse.checked_sub(AHEAD) {
                self.prefetch(later);
            }
            for wedge in coarser.wedges..finer.wedges {
                self.check_corners(wedge, coarser, collapse)?;
            }
            if !self.log.changed_ends.is_empty() {
                for &wedge in &self.log.changed[range_of(&self.log.changed_ends, collapse)] {
                    let is_new = wedge < finer.wedges
                        && std::mem::replace(&mut last_change[wedge as usize], collapse as u32) != collapse as u32;
                    require_at(is_new, collapse, "it changes a wedge that is not there, or twice")?;
                }
            }
            self.seek(collapse);
            let comes_up = coarser.triangles..finer.triangles;
            require_at(self.are_below(comes_up, finer.wedges), collapse, "a triangle has a wedge that comes later")?;
        }
        Ok(())
    }

    /// The corners that a wedge takes over in a split belong to its parent until then, and are of triangles that are there.
    fn check_corners(&self, wedge: u32, coarser: Counts, collapse: usize) -> Checked {
        let corners = &self.log.corners[range_of(&self.log.corner_ends, wedge as usize)];
        let parent = self.log.wedge_parents[wedge as usize];
        let all = self.mesh.triangles.as_flattened();
        let is_parents =
            |&corner: &u32| corner < 3 * coarser.triangles && all[corner as usize] == parent && parent < coarser.wedges;
        require_at(corners.iter().all(is_parents), collapse, "a wedge takes over corners that are not its parent's")
    }

    fn are_below(&self, triangles: std::ops::Range<u32>, wedges: u32) -> bool {
        let triangles = &self.mesh.triangles[triangles.start as usize..triangles.end as usize];
        triangles.as_flattened().iter().all(|&wedge| wedge < wedges)
    }
}
