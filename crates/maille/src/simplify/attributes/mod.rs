//! Attributes in the metric: normals, colours, texture coordinates and whatever else wedges carry.

mod carried;
mod generalized;

mod gradients;

pub(super) use generalized::GeneralizedQuadrics;
pub(super) use gradients::AttributeMetric;

use super::options::SimplifyOptions;
use crate::mesh::{Attribute, Mesh, Values};

/// Attributes of vertices that count in the metric, which knows those of wedges only: where each was among the others.
#[derive(Debug, Clone, PartialEq, Default)]
pub(crate) struct Lifted(pub(crate) Vec<usize>);

impl Lifted {
    /// Makes them attributes of wedges, the last ones, for as long as edges collapse. Wedges of one vertex have equal values then,
    /// and keep sharing them.
    pub(super) fn lift(mesh: &mut Mesh, options: &SimplifyOptions) -> Self {
        let mut lifted = Vec::new();
        for i in (0..mesh.vertex_attributes.len()).rev() {
            let attribute = &mesh.vertex_attributes[i];
            let counts = matches!(attribute.values, Values::F32(_))
                && options.attributes.factor_of(&attribute.semantic) > 0.0
                && mesh.wedge_attribute(&attribute.semantic).is_none();
            if counts {
                let mut attribute = mesh.vertex_attributes.remove(i);
                attribute.gather(&mesh.wedge_vertices);
                mesh.wedge_attributes.push(attribute);
                lifted.push(i);
            }
        }
        Self(lifted)
    }

    /// Makes them attributes of vertices again.
    pub(crate) fn put_back(&self, mesh: &mut Mesh) {
        let mut wedge_of = vec![0; mesh.vertex_count()];
        for (w, &v) in (0..).zip(&mesh.wedge_vertices) {
            wedge_of[v as usize] = w;
        }
        for &i in self.0.iter().rev() {
            let mut attribute: Attribute = mesh.wedge_attributes.pop().expect("it was put there");
            attribute.gather(&wedge_of);
            mesh.vertex_attributes.insert(i, attribute);
        }
    }
}
