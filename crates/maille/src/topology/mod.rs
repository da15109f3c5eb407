//! Connectivity: who is next to whom.
//!
//! A [`Mesh`](crate::Mesh) knows only which wedges its triangles name. From it one builds a [`CornerTable`]: read-only,
//! two arrays, every adjacency in constant time, for any input however broken. It answers what the surface is as a
//! whole: [boundary loops](CornerTable::boundary_loops), [components](CornerTable::components),
//! [genus](CornerTable::genus), [orientability](CornerTable::is_orientable).
//!
//! Elements are named by 32-bit ids ([`VertexId`], [`FaceId`], [`CornerId`]); a half-edge has the name of the corner
//! that it leaves.
//!
//! For editing there is [`CollapseMesh`], which edge collapse works on.

pub mod collapse_mesh;
mod corner_table;
pub(crate) mod edge_star;
pub(crate) mod edges;
pub(crate) mod fans;
mod ids;
mod surface;
mod union_find;

pub use collapse_mesh::CollapseMesh;
pub use corner_table::{CornerTable, Fan, TopologyError, TopologyReport};
pub use edge_star::EdgeStar;
pub use ids::{CornerId, FaceId, VertexId};
pub use surface::{BoundaryLoops, ClosedSurface, Component, Components};
pub(crate) use union_find::UnionFind;

#[cfg(test)]
mod collapse_tests;
#[cfg(test)]
mod tests;
