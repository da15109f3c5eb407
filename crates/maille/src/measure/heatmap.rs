//! Distances as colours.

use crate::Mesh;
use crate::mesh::{Attribute, ComponentType, Semantic, Storage};

/// The colour map viridis at nine places, sRGB bytes; between them it is as good as straight. Of even steps to the eye
/// and readable by the colour-blind (Smith and van der Walt, 2015, released as CC0).
const VIRIDIS: [[u8; 3]; 9] = [
    [68, 1, 84],
    [71, 45, 123],
    [59, 82, 139],
    [44, 114, 142],
    [33, 144, 140],
    [39, 173, 129],
    [93, 200, 99],
    [170, 220, 50],
    [253, 231, 37],
];

/// The colour of a share between 0 (dark violet) and 1 (yellow), sRGB-encoded, 0 to 1; what is outside gets the end's.
/// Grey for NaN.
pub fn viridis(share: f32) -> [f32; 3] {
    if share.is_nan() {
        return [0.5; 3];
    }
    let place = share.clamp(0.0, 1.0) * (VIRIDIS.len() - 1) as f32;
    let below = (place as usize).min(VIRIDIS.len() - 2);
    let t = place - below as f32;
    std::array::from_fn(|i| {
        let [from, to] = [below, below + 1].map(|k| f32::from(VIRIDIS[k][i]) / 255.0);
        from + (to - from) * t
    })
}

/// A copy of a mesh whose colours show a distance at each vertex (see
/// [`distances_at_vertices`](super::distances_at_vertices)): dark violet at `range[0]`, yellow at `range[1]` and
/// beyond.
///
/// The distances are also there as numbers, as the vertex attribute `distance`. Normals are kept; texture coordinates,
/// materials and blend shapes, which would hide the colours, are not.
///
/// # Panics
/// If there is not one distance to each vertex.
pub fn heatmap(original: &Mesh, distances: &[f32], range: [f32; 2]) -> Mesh {
    assert_eq!(distances.len(), original.vertex_count(), "one distance to each vertex");
    let extent = range[1] - range[0];
    let color = |&vertex: &u32| {
        let distance = distances[vertex as usize] - range[0];
        // with no range at all, everything is at its lower end
        viridis(if extent > 0.0 { distance / extent } else { 0.0 })
    };
    let colors = original.wedge_vertices.iter().flat_map(color).collect();
    let storage = Storage { component: ComponentType::U8, normalized: true, srgb: true };
    let normals = original.wedge_attribute(&Semantic::Normal).cloned();
    let colors = Attribute { storage, ..Attribute::new_f32(Semantic::Color(0), 3, colors) };
    let distance = Attribute::new_f32(Semantic::Custom("distance".to_owned()), 1, distances.to_vec());
    Mesh {
        positions: original.positions.clone(),
        wedge_vertices: original.wedge_vertices.clone(),
        triangles: original.triangles.clone(),
        wedge_attributes: normals.into_iter().chain([colors]).collect(),
        vertex_attributes: vec![distance],
        ..Mesh::default()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mesh::shapes;

    #[test]
    fn colours_run_from_violet_to_yellow_and_get_lighter() {
        let bytes = |share: f32| viridis(share).map(|x| (x * 255.0).round() as u8);
        assert_eq!((bytes(0.0), bytes(0.5), bytes(1.0)), ([68, 1, 84], [33, 144, 140], [253, 231, 37]));
        assert_eq!((viridis(-1.0), viridis(2.0), viridis(f32::NAN)), (viridis(0.0), viridis(1.0), [0.5; 3]));
        let luma = |i: usize| {
            let [r, g, b] = viridis(i as f32 / 100.0);
            0.2 * r + 0.7 * g + 0.1 * b
        };
        assert!((0..100).all(|i| luma(i) < luma(i + 1)));
    }

    #[test]
    fn every_wedge_has_the_colour_of_its_vertex() {
        let mut mesh = shapes::tetrahedron();
        mesh.wedge_vertices.push(1);
        mesh.triangles[1][2] = 4;
        let heat = heatmap(&mesh, &[0.0, 1.0, 2.0, 4.0], [0.0, 4.0]);
        assert_eq!(heat.check(), Ok(()));
        let colors = heat.wedge_attribute(&Semantic::Color(0)).and_then(Attribute::as_f32).expect("colours are floats");
        assert_eq!(&colors[3..6], &colors[12..15]);
        assert_eq!(&colors[9..12], &viridis(1.0));
        assert_eq!(heat.vertex_attributes[0].as_f32(), Some(&[0.0, 1.0, 2.0, 4.0][..]));
    }
}
