//! Named repairs, and the diagnosis that asks for them.
//!
//! Nothing in Maille repairs behind one's back: [`diagnose`] counts what is wrong with a mesh, [`repair`] applies the
//! repairs that one names, in that order, and tells what each changed. Everything stays as it was where there was
//! nothing to repair: same elements, same order, same bits.

mod diagnose;
mod surface;
mod triangles;

use crate::Mesh;
use crate::mesh::WeldOptions;

pub use diagnose::{Defect, Diagnosis, diagnose};

/// A repair by name.
///
/// ```
/// use maille::repair::Repair;
/// assert_eq!("drop-degenerate".parse(), Ok(Repair::DropDegenerate));
/// assert_eq!("drop-small-components=50".parse(), Ok(Repair::DropSmallComponents { min_triangles: 50 }));
/// assert!("polish".parse::<Repair>().is_err());
/// ```
#[derive(Debug, Clone, Copy, PartialEq)]
#[non_exhaustive]
pub enum Repair {
    /// Drops vertices that are infinite or not a number with their triangles, and sets attributes that are to 0.
    /// Normals and tangents set to 0 should be computed anew.
    DropNonFinite,
    /// Merges vertices at the same place ([`Mesh::weld`]).
    Weld(WeldOptions),
    /// Drops triangles that name a vertex twice.
    DropDegenerate,
    /// Drops triangles whose height is less than 2^-24 of their longest edge: nothing that `f32` could tell from a line.
    /// Where such a needle lies between two others, they are left with a crack of no width.
    DropZeroArea,
    /// Drops triangles with the same vertices in the same winding as an earlier one.
    DropDuplicates,
    /// Drops triangles with the same vertices in the opposite winding as an earlier one. Not part of
    /// [`STANDARD`](Self::STANDARD): such pairs are often the two sides of a leaf or a sheet, on purpose.
    DropOppositeDuplicates,
    /// Duplicates vertices until every edge has at most two triangles and every vertex one fan. Surfaces part at edges of
    /// three triangles or more and where they touch at a vertex only; where it makes no difference nothing is cut.
    SplitNonManifold,
    /// Turns triangles until all agree with their neighbours. A surface that has to be changed turns outwards if it is
    /// closed, and else keeps the winding of most of its triangles. Surfaces that agree already, and those that cannot
    /// (a Möbius band), stay. Attributes (normals) stay.
    UnifyWinding,
    /// [`UnifyWinding`](Self::UnifyWinding), and turns every closed surface outwards: also cavities inside of others.
    OrientOutward,
    /// Drops components, joined by edges, of fewer triangles.
    DropSmallComponents {
        /// The least number of triangles that is kept.
        min_triangles: u32,
    },
    /// Drops wedges that no triangle and vertices that no wedge in use refers to.
    DropUnreferenced,
}

/// Names of all repairs, what each name means without a parameter, and what it does, in one line.
pub const NAMES: [(&str, Repair, &str); 11] = [
    (
        "drop-non-finite",
        Repair::DropNonFinite,
        "drop vertices at NaN or infinity with their triangles, set such attributes to 0",
    ),
    ("weld", Repair::Weld(WeldOptions::EXACT), "merge vertices at the same place (weld=D: not farther apart than D)"),
    ("drop-degenerate", Repair::DropDegenerate, "drop triangles that name a vertex twice"),
    ("drop-zero-area", Repair::DropZeroArea, "drop triangles without area"),
    ("drop-duplicates", Repair::DropDuplicates, "drop repeated triangles of the same winding"),
    ("drop-opposite-duplicates", Repair::DropOppositeDuplicates, "drop repeated triangles of the opposite winding"),
    ("split-non-manifold", Repair::SplitNonManifold, "cut the surface where more than two sides meet"),
    ("unify-winding", Repair::UnifyWinding, "make neighbours agree in winding"),
    ("orient-outward", Repair::OrientOutward, "the same, and turn closed surfaces outwards"),
    (
        "drop-small-components",
        Repair::DropSmallComponents { min_triangles: 10 },
        "drop pieces of fewer than 10 triangles (drop-small-components=N: than N)",
    ),
    ("drop-unreferenced", Repair::DropUnreferenced, "drop vertices and wedges without triangles"),
];

impl Repair {
    /// What mends a mesh without taking away anything that could be meant: the order matters.
    pub const STANDARD: [Self; 7] = [
        Self::DropNonFinite,
        Self::Weld(WeldOptions::EXACT),
        Self::DropDegenerate,
        Self::DropDuplicates,
        Self::SplitNonManifold,
        Self::UnifyWinding,
        Self::DropUnreferenced,
    ];

    /// Its name in [`NAMES`].
    pub fn name(&self) -> &'static str {
        let same = |other: &Self| std::mem::discriminant(self) == std::mem::discriminant(other);
        NAMES.iter().find(|(_, repair, _)| same(repair)).expect("the table holds every repair").0
    }
}

/// A text that names no repair.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum ParseRepairError {
    /// There is no repair of that name.
    #[error("there is no repair '{name}'; there are {}", NAMES.map(|(name, ..)| name).join(", "))]
    UnknownName {
        /// What was found.
        name: String,
    },
    /// What follows the `=` does not fit.
    #[error("the repair '{name}' does not take the value '{value}'")]
    BadValue {
        /// Name of the repair.
        name: &'static str,
        /// What was found.
        value: String,
    },
}

impl std::str::FromStr for Repair {
    type Err = ParseRepairError;

    /// Reads `name` or `name=value`.
    fn from_str(text: &str) -> Result<Self, ParseRepairError> {
        let (name, value) = text.split_once('=').map_or((text, None), |(name, value)| (name, Some(value)));
        let unknown = || ParseRepairError::UnknownName { name: name.to_owned() };
        let &(name, repair, _) = NAMES.iter().find(|(known, ..)| *known == name).ok_or_else(unknown)?;
        let Some(value) = value else { return Ok(repair) };
        let parsed = match repair {
            Self::Weld(options) => {
                let tolerance = value.parse().ok().filter(|&d: &f64| d >= 0.0 && d.is_finite());
                tolerance.map(|tolerance| Self::Weld(WeldOptions { tolerance, ..options }))
            }
            Self::DropSmallComponents { .. } => {
                value.parse().ok().map(|min_triangles| Self::DropSmallComponents { min_triangles })
            }
            _ => None,
        };
        parsed.ok_or_else(|| ParseRepairError::BadValue { name, value: value.to_owned() })
    }
}

/// What [`repair`] changed.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct RepairReport {
    /// Vertices dropped because they were not finite.
    pub non_finite_vertices_dropped: usize,
    /// Triangles dropped because they named such a vertex.
    pub non_finite_triangles_dropped: usize,
    /// Scalars of attributes set to 0 because they were not finite.
    pub non_finite_values_zeroed: usize,
    /// Vertices merged into others.
    pub vertices_merged: usize,
    /// Wedges merged into others.
    pub wedges_merged: usize,
    /// Triangles dropped because they named a vertex twice.
    pub degenerate_dropped: usize,
    /// Triangles dropped because they had no area.
    pub zero_area_dropped: usize,
    /// Triangles dropped because they repeated another.
    pub duplicates_dropped: usize,
    /// Triangles dropped because they repeated another in opposite winding.
    pub opposite_duplicates_dropped: usize,
    /// Vertices added by splitting.
    pub vertices_added: usize,
    /// Wedges added by splitting.
    pub wedges_added: usize,
    /// Triangles turned over.
    pub triangles_turned: usize,
    /// Surfaces left alone because their triangles cannot agree.
    pub non_orientable_surfaces: usize,
    /// Components dropped because they were small.
    pub small_components_dropped: usize,
    /// Triangles of those.
    pub small_component_triangles_dropped: usize,
    /// Vertices dropped because nothing referred to them.
    pub unreferenced_vertices_dropped: usize,
    /// Wedges dropped because nothing referred to them.
    pub unreferenced_wedges_dropped: usize,
}

impl RepairReport {
    /// All counts with a name for each, for printing.
    pub fn counts(&self) -> [(&'static str, usize); 17] {
        [
            ("non_finite_vertices_dropped", self.non_finite_vertices_dropped),
            ("non_finite_triangles_dropped", self.non_finite_triangles_dropped),
            ("non_finite_values_zeroed", self.non_finite_values_zeroed),
            ("vertices_merged", self.vertices_merged),
            ("wedges_merged", self.wedges_merged),
            ("degenerate_dropped", self.degenerate_dropped),
            ("zero_area_dropped", self.zero_area_dropped),
            ("duplicates_dropped", self.duplicates_dropped),
            ("opposite_duplicates_dropped", self.opposite_duplicates_dropped),
            ("vertices_added", self.vertices_added),
            ("wedges_added", self.wedges_added),
            ("triangles_turned", self.triangles_turned),
            ("non_orientable_surfaces", self.non_orientable_surfaces),
            ("small_components_dropped", self.small_components_dropped),
            ("small_component_triangles_dropped", self.small_component_triangles_dropped),
            ("unreferenced_vertices_dropped", self.unreferenced_vertices_dropped),
            ("unreferenced_wedges_dropped", self.unreferenced_wedges_dropped),
        ]
    }

    /// Whether nothing was changed.
    pub fn is_unchanged(&self) -> bool {
        Self { non_orientable_surfaces: 0, ..*self } == Self::default()
    }
}

/// Applies repairs in their order and reports what they changed. What they leave keeps its order.
///
/// Cost: each is linear but for sorting the edges around each vertex; some 52 bytes per triangle for a while.
///
/// # Panics
/// If [`Mesh::check`] fails.
///
/// # Examples
/// ```
/// use maille::{Mesh, repair::{Repair, diagnose, repair}};
/// let positions = vec![[0., 0., 0.], [1., 0., 0.], [0., 1., 0.], [9., 9., 9.]];
/// let mut mesh = Mesh::from_triangles(positions, vec![[0, 1, 2], [1, 2, 0], [0, 1, 1]])?;
/// let report = repair(&mut mesh, &Repair::STANDARD);
/// assert_eq!((report.degenerate_dropped, report.duplicates_dropped), (1, 1));
/// assert_eq!((report.unreferenced_vertices_dropped, mesh.triangles.len()), (1, 1));
/// assert_eq!(diagnose(&mesh).defects().count(), 0);
/// # Ok::<(), maille::mesh::MeshError>(())
/// ```
pub fn repair(mesh: &mut Mesh, repairs: &[Repair]) -> RepairReport {
    let mut report = RepairReport::default();
    for repair in repairs {
        apply(mesh, *repair, &mut report);
    }
    report
}

fn apply(mesh: &mut Mesh, repair: Repair, report: &mut RepairReport) {
    match repair {
        Repair::DropNonFinite => triangles::drop_non_finite(mesh, report),
        Repair::Weld(options) => {
            let merged = mesh.weld(&options);
            report.vertices_merged += merged.vertices_merged;
            report.wedges_merged += merged.wedges_merged;
        }
        Repair::DropDegenerate => report.degenerate_dropped += triangles::drop_degenerate(mesh),
        Repair::DropZeroArea => report.zero_area_dropped += triangles::drop_zero_area(mesh),
        Repair::DropDuplicates => {
            report.duplicates_dropped += triangles::drop_duplicates(mesh, |duplicate| duplicate.repeats);
        }
        Repair::DropOppositeDuplicates => {
            report.opposite_duplicates_dropped += triangles::drop_duplicates(mesh, |duplicate| duplicate.opposes);
        }
        Repair::SplitNonManifold => {
            let (vertices, wedges) = surface::split_non_manifold(mesh);
            report.vertices_added += vertices;
            report.wedges_added += wedges;
        }
        Repair::UnifyWinding => surface::wind(mesh, false, report),
        Repair::OrientOutward => surface::wind(mesh, true, report),
        Repair::DropSmallComponents { min_triangles } => {
            let (components, triangles) = triangles::drop_small_components(mesh, min_triangles);
            report.small_components_dropped += components;
            report.small_component_triangles_dropped += triangles;
        }
        Repair::DropUnreferenced => {
            let (vertices, wedges) = triangles::drop_unreferenced(mesh);
            report.unreferenced_vertices_dropped += vertices;
            report.unreferenced_wedges_dropped += wedges;
        }
    }
}

#[cfg(test)]
mod tests;
