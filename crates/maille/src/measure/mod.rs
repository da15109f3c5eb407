//! How far apart two surfaces are, and how good one is.
//!
//! [`compare`] answers the first by samples, [`hausdorff`] proves the largest distance, [`Figures`] answers the second; [`Bvh`] and [`SurfaceSampler`] are what they are made of.

mod attributes;
mod bvh;
mod chunks;
mod compare;
mod cover;
pub(crate) mod exact;
mod figures;
mod heatmap;
mod sample;
pub(crate) mod triangle;

pub use attributes::{AttributeDeviation, compare_attributes};
pub use bvh::{Bvh, ClosestPoint, Searcher};
pub(crate) use compare::Watch;
pub use compare::{
    CompareError, CompareOptions, Comparison, Deviation, NormalDeviation, Side, compare, distances_at_vertices,
};
pub use exact::{ExactComparison, ExactOptions, ProvenDistance, hausdorff};
pub use figures::{
    BAD_ANGLE_DEG, Figures, Quality, area, boundary_length, euler_characteristic, smallest_angles_deg, volume,
};
pub use heatmap::{heatmap, viridis};
pub use sample::{SurfaceSample, SurfaceSampler};
