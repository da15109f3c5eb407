//! Which wedge of a coarser level each wedge of a finer one becomes.

use crate::Mesh;
use crate::mesh::MeshError;

/// Which wedge of a coarser level each wedge of a finer level becomes (Houle 2000, 5.2).
///
/// ```text
///   finer          coarser               a-b-c collapsed: all three wedges become 0,
///   a---b---c                            d stays and becomes 1; what is between a, b
///    \ / \ /   ->   0                    and d gets no area and is not seen any more
///     d---e         |\
///                   1-2
/// ```
///
/// Plain data that anybody may fill in: [`check`](Self::check) tests it against the two levels. Correspondences of
/// neighbouring levels [chain up](Self::then) to those of any two levels.
///
/// # Examples
/// ```
/// use maille::lod::{Correspondence, Target};
/// // four wedges become two, and a loose part that ends with the first level shrinks to a point
/// let first = Correspondence { wedges: vec![0, 0, 1, 1, 2], vanishing: vec![[0.5; 3]], coarser_wedges: 2 };
/// let second = Correspondence { wedges: vec![0, 0], vanishing: Vec::new(), coarser_wedges: 1 };
/// let both = first.then(&second);
/// assert_eq!(both.target(3), Target::Wedge(0));
/// assert_eq!(both.target(4), Target::Point([0.5; 3]));
/// ```
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Correspondence {
    /// For each wedge of the finer level, a wedge of the coarser one; or, if its part of the surface is no more there,
    /// the number of wedges of the coarser level plus an index into [`vanishing`](Self::vanishing).
    pub wedges: Vec<u32>,
    /// The points that vanished parts have shrunk to, in model units.
    pub vanishing: Vec<[f32; 3]>,
    /// Number of wedges of the coarser level.
    pub coarser_wedges: u32,
}

/// What a wedge of the finer level becomes.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Target {
    /// A wedge of the coarser level.
    Wedge(u32),
    /// Nothing; its part of the surface shrinks to this point, in model units.
    Point([f32; 3]),
}

/// Why a [`Correspondence`] does not fit two levels.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum CorrespondenceError {
    /// It is made for a finer level of another size.
    #[error("correspondence of {found} wedges, but the finer level has {expected}")]
    FinerWedges {
        /// Wedges that it maps.
        found: usize,
        /// Wedges of the mesh.
        expected: usize,
    },
    /// It is made for a coarser level of another size.
    #[error("correspondence to {found} wedges, but the coarser level has {expected}")]
    CoarserWedges {
        /// Wedges that it maps to.
        found: usize,
        /// Wedges of the mesh.
        expected: usize,
    },
    /// A wedge becomes one that does not exist, nor a vanishing point.
    #[error("wedge {wedge} becomes {target}, but there are only {wedges} wedges and {vanishing} vanishing points")]
    OutOfRange {
        /// Which wedge of the finer level.
        wedge: usize,
        /// What it becomes.
        target: u32,
        /// Wedges of the coarser level.
        wedges: u32,
        /// Number of vanishing points.
        vanishing: usize,
    },
}

impl Correspondence {
    /// Each of so many wedges becomes itself.
    pub fn identity(wedges: u32) -> Self {
        Self { wedges: (0..wedges).collect(), vanishing: Vec::new(), coarser_wedges: wedges }
    }

    /// What a wedge of the finer level becomes.
    ///
    /// # Panics
    /// If there is no such wedge, or what it becomes is out of range.
    #[inline]
    pub fn target(&self, wedge: u32) -> Target {
        let target = self.wedges[wedge as usize];
        match target.checked_sub(self.coarser_wedges) {
            None => Target::Wedge(target),
            Some(point) => Target::Point(self.vanishing[point as usize]),
        }
    }

    /// Tests that it maps the wedges of the one mesh to those of the other.
    ///
    /// # Errors
    /// The first [`CorrespondenceError`] found. Linear in the number of wedges.
    pub fn check(&self, finer: &Mesh, coarser: &Mesh) -> Result<(), CorrespondenceError> {
        if self.wedges.len() != finer.wedge_count() {
            let (found, expected) = (self.wedges.len(), finer.wedge_count());
            return Err(CorrespondenceError::FinerWedges { found, expected });
        }
        if self.coarser_wedges as usize != coarser.wedge_count() {
            let (found, expected) = (self.coarser_wedges as usize, coarser.wedge_count());
            return Err(CorrespondenceError::CoarserWedges { found, expected });
        }
        let targets = self.coarser_wedges as usize + self.vanishing.len();
        match self.wedges.iter().position(|&target| target as usize >= targets) {
            None => Ok(()),
            Some(wedge) => Err(CorrespondenceError::OutOfRange {
                wedge,
                target: self.wedges[wedge],
                wedges: self.coarser_wedges,
                vanishing: self.vanishing.len(),
            }),
        }
    }

    /// The same between levels whose wedges are in another order: to each level, the number that each wedge had before.
    ///
    /// # Panics
    /// If a number is out of range, or a wedge that others become is left out.
    #[must_use]
    pub fn reordered(&self, finer: &[u32], coarser: &[u32]) -> Self {
        let mut new = vec![u32::MAX; self.coarser_wedges as usize];
        (0..).zip(coarser).for_each(|(number, &wedge)| new[wedge as usize] = number);
        let coarser_wedges = coarser.len() as u32;
        let target = |&wedge: &u32| {
            let target = self.wedges[wedge as usize];
            let number = match target.checked_sub(self.coarser_wedges) {
                None => new[target as usize],
                Some(point) => coarser_wedges + point,
            };
            assert_ne!(number, u32::MAX, "wedge {target} of the coarser level is left out");
            number
        };
        Self { wedges: finer.iter().map(target).collect(), vanishing: self.vanishing.clone(), coarser_wedges }
    }

    /// From the finer level of this one to the coarser level of the next, over the level that both share.
    ///
    /// What vanished on the first way stays at its point. Linear in the number of wedges; associative, to the bit.
    ///
    /// # Panics
    /// If `next` starts from another number of wedges than this ends with, an index is out of range, or more than 2^32
    /// wedges and vanishing points come together.
    #[must_use]
    pub fn then(&self, next: &Self) -> Self {
        assert_eq!(self.coarser_wedges as usize, next.wedges.len(), "the next correspondence starts where this ends");
        let first_point = next.coarser_wedges;
        let kept_points = u32::try_from(self.vanishing.len()).expect("points are counted in 32 bits");
        let points = self.vanishing.len() + next.vanishing.len();
        assert!(first_point as usize + points <= u32::MAX as usize, "targets are counted in 32 bits");
        let compose = |&middle: &u32| match middle.checked_sub(self.coarser_wedges) {
            Some(point) => {
                assert!(point < kept_points, "the vanishing point exists");
                first_point + point
            }
            None => match next.wedges[middle as usize] {
                wedge if wedge < first_point => wedge,
                vanishing => {
                    assert!(((vanishing - first_point) as usize) < next.vanishing.len(), "the vanishing point exists");
                    vanishing + kept_points
                }
            },
        };
        Self {
            wedges: self.wedges.iter().map(compose).collect(),
            vanishing: [&*self.vanishing, &*next.vanishing].concat(),
            coarser_wedges: next.coarser_wedges,
        }
    }

    /// The correspondence of a level with one that was not made from it, or was edited since, by nearest points
    /// (Houle 2000, 6.1.3).
    ///
    /// Each vertex of the finer level goes to the nearest point of the coarser surface and from there to the corner of
    /// that triangle that counts most in it; all wedges of a vertex go to wedges of one vertex, so that nothing tears.
    /// Which of these a wedge becomes is told by normals and texture coordinates: the one with the least sum of
    /// squared differences over what both levels have (1 unit of a normal, which is 60 degrees, counts as much as the
    /// whole side of a texture), and of equal ones the first. A coarser level without triangles takes every part of
    /// the finer one to the mean of its vertices; vertices that are not finite stay where they are.
    ///
    /// What it cannot know: vertices of the coarser level that are nearest to none of the finer one are reached by
    /// nobody, so that a small change is left for the moment when levels switch; and walls thinner than the levels are
    /// apart may be taken for each other.
    ///
    /// Cost: a box hierarchy over the coarser level, and a search for each vertex of the finer one.
    ///
    /// # Errors
    /// [`MeshError`] if [`Mesh::check`] fails for one of the levels.
    ///
    /// # Examples
    /// ```
    /// use maille::{lod::Correspondence, mesh::shapes};
    /// let (finer, coarser) = (shapes::sphere(3), shapes::sphere(1));
    /// let correspondence = Correspondence::closest(&finer, &coarser)?;
    /// // the corners of the coarser sphere are corners of the finer one, too
    /// assert_eq!(correspondence.wedges[..6], [0, 1, 2, 3, 4, 5]);
    /// # Ok::<(), maille::mesh::MeshError>(())
    /// ```
    pub fn closest(finer: &Mesh, coarser: &Mesh) -> Result<Self, MeshError> {
        super::closest::closest(finer, coarser)
    }
}
