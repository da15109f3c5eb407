//! Connectivity: who is next to whom.

mod ids;
mod union_find;

pub use ids::{CornerId, FaceId, VertexId};
pub(crate) use union_find::UnionFind;
