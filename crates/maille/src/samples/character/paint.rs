//! Crisp borders between colours: vertices move onto them, and get a wedge for each colour that meets there.

use std::collections::BTreeMap;

use glam::Vec3;
use rayon::prelude::*;

use super::body::{Body, Region};
use super::{Neighbours, onto_surface};
use crate::samples::isosurface::Surface;

/// Moves vertices near a border onto it, along the edge that crosses it first.
pub(super) fn snap_to_borders(body: &Body, surface: &mut Surface) {
    let neighbours = Neighbours::new(surface);
    let positions = &surface.positions;
    let regions: Vec<Region> = positions.par_iter().map(|&p| body.region(p.into())).collect();
    let snapped = |v: usize| {
        let p = Vec3::from(positions[v]);
        let crossing = |&w: &u32| {
            let other = Vec3::from(positions[w as usize]);
            (regions[w as usize] != regions[v]).then(|| (border(body, p, other, regions[v]), w))
        };
        let nearest =
            neighbours.of(v).iter().filter_map(crossing).min_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
        match nearest {
            // the far end of the edge takes the other cases
            Some((t, w)) if t <= 0.5 => onto_surface(body, p.lerp(positions[w as usize].into(), t)).to_array(),
            _ => p.to_array(),
        }
    };
    surface.positions = (0..positions.len()).into_par_iter().map(snapped).collect();
}

/// The share of the way at which an edge leaves a region, by bisection.
fn border(body: &Body, from: Vec3, to: Vec3, region: Region) -> f32 {
    let (mut low, mut high) = (0.0, 1.0);
    for _ in 0..8 {
        let middle = 0.5 * (low + high);
        if body.region(from.lerp(to, middle)) == region {
            low = middle;
        } else {
            high = middle;
        }
    }
    high
}

/// Wedges (their vertices), triangles over them, and the colour of each wedge.
pub(super) struct Painted {
    pub(super) wedge_vertices: Vec<u32>,
    pub(super) triangles: Vec<[u32; 3]>,
    pub(super) colors: Vec<[f32; 3]>,
}

/// Gives each triangle the region of its middle, and each vertex a wedge for each region around it.
pub(super) fn paint(body: &Body, surface: &Surface) -> Painted {
    let point = |v: u32| Vec3::from(surface.positions[v as usize]);
    let middle = |t: &[u32; 3]| body.region((point(t[0]) + point(t[1]) + point(t[2])) / 3.0);
    let regions: Vec<Region> = surface.triangles.par_iter().map(middle).collect();
    let pairs: Vec<[(u32, Region); 3]> =
        surface.triangles.iter().zip(&regions).map(|(t, &region)| t.map(|v| (v, region))).collect();
    // by vertex, so that wedges lie in the order of their vertices
    let mut wedges: BTreeMap<(u32, Region), u32> = pairs.iter().flatten().map(|&pair| (pair, 0)).collect();
    for (number, wedge) in wedges.values_mut().enumerate() {
        *wedge = number as u32;
    }
    let keys: Vec<(u32, Region)> = wedges.keys().copied().collect();
    Painted {
        wedge_vertices: keys.iter().map(|&(vertex, _)| vertex).collect(),
        triangles: pairs.iter().map(|t| t.map(|pair| wedges[&pair])).collect(),
        colors: keys.par_iter().map(|&(vertex, region)| body.color(region, point(vertex)).to_array()).collect(),
    }
}
