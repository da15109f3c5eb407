//! Repairs of how triangles hang together.

use std::collections::BTreeMap;

use super::RepairReport;
use crate::Mesh;
use crate::topology::{CornerId, CornerTable, FaceId};

/// Gives every sheet of a vertex beyond the first a vertex of its own; returns how many vertices and wedges were added.
///
/// Why one pass is enough: faces are joined across edges of two faces only, so an edge of three or more lies at the ends
/// of sheets, and a sheet has two ends. After the split at most two faces are left at any copy of the edge.
pub(super) fn split_non_manifold(mesh: &mut Mesh) -> (usize, usize) {
    let table = CornerTable::of_vertices(mesh);
    let mut sheets = table.sheets();
    sheets.sort_by_key(|sheet| (sheet.vertex, sheet.number));
    // a wedge goes with the first sheet that uses it; those of degenerate triangles, which are in no sheet, stay
    let mut taken = vec![false; mesh.wedge_count()];
    for face in table.faces().filter(|&f| table.is_degenerate(f)) {
        mesh.triangles[face.index()].iter().for_each(|&w| taken[w as usize] = true);
    }
    let mut vertices: Vec<u32> = (0..mesh.vertex_count() as u32).collect();
    let mut wedges: Vec<u32> = (0..mesh.wedge_count() as u32).collect();
    let mut moved = Vec::new();
    for fans in sheets.chunk_by(|a, b| (a.vertex, a.number) == (b.vertex, b.number)) {
        let first = fans[0].number == 0;
        let vertex = if first { fans[0].vertex } else { vertices.len() as u32 };
        if !first {
            vertices.push(fans[0].vertex);
        }
        let mut renamed = BTreeMap::new();
        for corner in fans.iter().flat_map(|fan| table.fan_from(CornerId(fan.start)).corners()) {
            let wedge = &mut mesh.triangles.as_flattened_mut()[corner.index()];
            *wedge = *renamed.entry(*wedge).or_insert_with(|| {
                let free = !std::mem::replace(&mut taken[*wedge as usize], true);
                if first {
                    return *wedge;
                }
                let name = if free { *wedge } else { wedges.len() as u32 };
                if !free {
                    wedges.push(*wedge);
                }
                moved.push((name, vertex));
                name
            });
        }
    }
    let added = (vertices.len() - mesh.vertex_count(), wedges.len() - mesh.wedge_count());
    if added.0 > 0 {
        mesh.gather_vertices(&vertices);
        mesh.gather_wedges(&wedges);
        moved.into_iter().for_each(|(wedge, vertex)| mesh.wedge_vertices[wedge as usize] = vertex);
    }
    added
}

/// What is to be known of a surface before it is decided which way to wind it.
#[derive(Debug, Clone, Copy, Default)]
struct Surface {
    components: u32,
    /// Faces that would turn to agree with the first component.
    turned: u64,
    kept: u64,
    open: bool,
    /// Six times the signed volume once all agree with the first component.
    volume: f64,
}

impl Surface {
    /// Whether to turn what agrees with the first component instead of the rest.
    fn is_inverted(&self) -> bool {
        let closed = !self.open && self.volume != 0.0 && self.volume.is_finite();
        if closed { self.volume < 0.0 } else { self.turned > self.kept }
    }
}

/// Unifies the winding of each surface; `outward` also turns closed ones that agree already.
pub(super) fn wind(mesh: &mut Mesh, outward: bool, report: &mut RepairReport) {
    let table = CornerTable::of_vertices(mesh);
    if table.inconsistent_edges().is_empty() && !outward {
        return;
    }
    let orientation = table.orientation();
    let mut surfaces = vec![Surface::default(); orientation.orientable.len()];
    for &surface in &orientation.surface {
        surfaces[surface as usize].components += 1;
    }
    let origin = mesh.bounds().map_or(glam::DVec3::ZERO, |(low, high)| (to_f64(low) + to_f64(high)) * 0.5);
    let component_of = |f: FaceId| orientation.components.of_face(f);
    let inconsistent = sorted_corners(table.inconsistent_edges());
    for face in table.faces() {
        let Some(component) = component_of(face) else { continue };
        let surface = &mut surfaces[orientation.surface[component] as usize];
        let turned = orientation.turned[component];
        *(if turned { &mut surface.turned } else { &mut surface.kept }) += 1;
        let [a, b, c] = mesh.triangle_points(face.index()).map(|p| p - origin);
        surface.volume += a.cross(b).dot(c) * if turned { -1.0 } else { 1.0 };
        let cut = |&h: &CornerId| table.is_boundary(h) && inconsistent.binary_search(&h.0).is_err();
        surface.open |= table.face_half_edges(face).iter().any(cut);
    }
    report.non_orientable_surfaces += orientation.orientable.iter().filter(|&&yes| !yes).count();
    for face in table.faces() {
        let Some(component) = component_of(face) else { continue };
        let number = orientation.surface[component] as usize;
        let surface = &surfaces[number];
        let wanted = orientation.orientable[number] && (surface.components > 1 || outward && !surface.open);
        if wanted && orientation.turned[component] != surface.is_inverted() {
            mesh.triangles[face.index()].swap(1, 2);
            report.triangles_turned += 1;
        }
    }
}

fn sorted_corners(edges: &[[u32; 2]]) -> Vec<u32> {
    let mut corners = edges.as_flattened().to_vec();
    corners.sort_unstable();
    corners
}

fn to_f64(position: [f32; 3]) -> glam::DVec3 {
    glam::Vec3::from(position).as_dvec3()
}
