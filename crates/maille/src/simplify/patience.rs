//! A bound on the work at vertices of very many faces.

use crate::topology::CollapseMesh;

/// Faces around a vertex from which on walking around it counts as costly.
const LARGE: usize = 1024;

/// How many faces at such vertices are walked past for each face of the mesh: enough for any vertex of a real model,
/// while a hundred thousand faces on one vertex do not make the time quadratic.
const PER_FACE: usize = 64;

/// How many more faces may be walked past at vertices of very many.
#[derive(Debug, Default)]
pub(super) struct Patience(usize);

impl Patience {
    pub(super) fn new(mesh: &CollapseMesh) -> Self {
        Self(PER_FACE * mesh.live_face_count())
    }

    /// Whether walking around a vertex is worth it: always, unless it has very many faces and that has taken too long
    /// already.
    pub(super) fn allows(&self, mesh: &CollapseMesh, vertex: u32) -> bool {
        self.0 > 0 || mesh.faces_around(vertex).nth(LARGE).is_none()
    }

    /// So many faces have been walked past.
    pub(super) fn spend(&mut self, faces: usize) {
        if faces > LARGE {
            self.0 = self.0.saturating_sub(faces);
        }
    }
}
