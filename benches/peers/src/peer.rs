//! What a simplifier looks like from here.

use anyhow::Result;
use maille::Mesh;

use crate::memory::Cost;

/// A simplifier.
pub trait Peer {
    /// Name in tables and for `--tools`.
    fn name(&self) -> &str;

    /// Version of the library.
    fn version(&self) -> &str;

    /// Simplifies a mesh of positions to about so many triangles. The cost is that of the algorithm on data in memory in
    /// the form it wants.
    fn simplify(&self, mesh: &Mesh, triangles: usize) -> Result<(Mesh, Cost)>;
}
