//! Pictures to be compared pixel by pixel.
//!
//! What a graphics card draws without shadows: multisampling with 257 samples to a pixel, textures with trilinear filtering, one
//! lamp and a sky. Where the scene moves by a little, each pixel changes by a little; cards have 4 to 16 samples, so that what an
//! outline changes comes in larger steps there, with any way to move it.

use glam::{Vec2, Vec3};
use rayon::prelude::*;

use super::Scene;
use super::camera::Camera;
use super::raster::{self, NOTHING, Visible};
use super::shade::screen_weights;

/// A pixel to the right is this many samples to the right and one up, a pixel down this many down and one to the right: a
/// square grid that is turned, with this squared and one more samples in each pixel, all in columns and rows of their own. So
/// edges along either take them one by one. Edges along the grid take as many at a time as it has in a row, so that a change
/// below a sixteenth of the contrast is lost in that.
const STEP: usize = 16;
const SAMPLES: usize = STEP * STEP + 1;
const BACKDROP: Vec3 = Vec3::splat(0.4);
const KEY: f32 = 0.62;
const SKY: f32 = 0.34;
const GROUND: f32 = 0.16;
const GLOSS: f32 = 0.16;
const SHININESS: i32 = 28;

/// Draws a scene. The colours are light, white is 1; rows from the top.
pub(crate) fn draw_plain(scene: &Scene, camera: &Camera) -> Vec<Vec3> {
    let (width, height) = (camera.size().0 as usize, camera.size().1 as usize);
    let points: Vec<Vec3> = scene.points.par_iter().map(|&p| camera.project(p)).collect();
    let step = STEP as f32;
    let turned = |p: &Vec3| Vec3::new(step * p.x + p.y, step * p.y - p.x + width as f32, p.z);
    let samples: Vec<Vec3> = points.par_iter().map(turned).collect();
    let seen = raster::visible(&samples, &scene.triangles, STEP * width + height, STEP * height + width);
    let painter = Painter { scene, camera, points: &points, seen: &seen, grid: grid(), width };
    (0..width * height).into_par_iter().map(|at| painter.pixel(at)).collect()
}

/// The samples of the first pixel: columns and rows of the turned grid, and the places in the pixel.
fn grid() -> Vec<([isize; 2], Vec2)> {
    let side = STEP as isize;
    let cells = (-1..=side).flat_map(|row| (0..=side + 1).map(move |column| [column, row]));
    let place = |[column, row]: [isize; 2]| {
        let (u, v, step) = (column as f32 + 0.5, row as f32 + 0.5, STEP as f32);
        Vec2::new(step * u - v, step * v + u) / SAMPLES as f32
    };
    let is_inside = |p: Vec2| p.cmpge(Vec2::ZERO).all() && p.cmplt(Vec2::ONE).all();
    cells.map(|cell| (cell, place(cell))).filter(|&(_, place)| is_inside(place)).collect()
}

struct Painter<'a> {
    scene: &'a Scene,
    camera: &'a Camera,
    /// In pixels.
    points: &'a [Vec3],
    /// Over the turned grid.
    seen: &'a Visible,
    grid: Vec<([isize; 2], Vec2)>,
    width: usize,
}

impl Painter<'_> {
    /// Each triangle that a pixel sees is shaded once, in the middle of the samples that see it.
    fn pixel(&self, at: usize) -> Vec3 {
        let (x, y) = (at % self.width, at / self.width);
        let (column, row) = (STEP * x + y, STEP * y + self.width - x);
        let triangle = |&([dx, dy], place): &([isize; 2], Vec2)| {
            let index = row.wrapping_add_signed(dy) * self.seen.width + column.wrapping_add_signed(dx);
            (self.seen.triangle[index], place)
        };
        let mut seen: [(u32, Vec2); SAMPLES] = std::array::from_fn(|sample| triangle(&self.grid[sample]));
        seen.sort_by_key(|&(triangle, _)| triangle); // stable: sums are the same on every machine
        let light = seen.chunk_by(|a, b| a.0 == b.0).map(|same| {
            let count = same.len() as f32;
            let middle = same.iter().map(|&(_, place)| place).sum::<Vec2>() / count;
            count * self.light(same[0].0, Vec2::new(x as f32, y as f32) + middle)
        });
        (light.sum::<Vec3>() / SAMPLES as f32).min(Vec3::ONE)
    }

    fn light(&self, triangle: u32, at: Vec2) -> Vec3 {
        if triangle == NOTHING {
            return BACKDROP;
        }
        let ids = self.scene.triangles[triangle as usize];
        let corners = ids.map(|v| self.points[v as usize]);
        let [own, right, below] = [Vec2::ZERO, Vec2::X, Vec2::Y].map(|step| perspective_weights(corners, at + step));
        let weights = [inside(own), right, below];
        let blend = |values: &[Vec3]| (0..3).map(|i| weights[0][i] * values[ids[i] as usize]).sum::<Vec3>();
        let eye = (self.camera.position - blend(&self.scene.points)).normalize_or(Vec3::Z);
        let normal = blend(&self.scene.normals).normalize_or(eye);
        // seen from behind (open surfaces, corners of outlines): mirrored, which changes nothing where it begins
        let normal = normal - 2.0 * normal.dot(eye).min(0.0) * eye;
        self.shaded(self.scene.filtered_albedo(triangle as usize, weights), normal, eye)
    }

    fn shaded(&self, albedo: Vec3, normal: Vec3, eye: Vec3) -> Vec3 {
        let axes = self.camera.axes();
        let key = (axes * Vec3::new(-0.62, 0.8, 0.62)).normalize();
        let sky = GROUND + (SKY - GROUND) * (0.5 + 0.5 * normal.dot(axes.y_axis));
        let gloss = GLOSS * normal.dot((eye + key).normalize_or(eye)).max(0.0).powi(SHININESS);
        albedo * (sky + KEY * normal.dot(key).max(0.0)) + gloss
    }
}

/// Barycentric weights in space of a place on the screen.
fn perspective_weights(corners: [Vec3; 3], at: Vec2) -> Vec3 {
    let weights = screen_weights(corners, at) * Vec3::from(corners.map(|corner| corner.z));
    weights / weights.element_sum()
}

/// Weights of a point of the triangle: of slivers, whose corners the raster rounds, a sample may lie far outside.
fn inside(weights: Vec3) -> Vec3 {
    let weights = weights.max(Vec3::ZERO);
    weights / weights.element_sum()
}

#[cfg(test)]
mod tests {
    use maille::lod::MorphedMesh;
    use maille::mesh::shapes;
    use maille_io::Asset;

    use super::super::{Frame, with_normals};
    use super::*;

    #[test]
    fn samples_share_no_row_and_no_column() {
        let grid = grid();
        assert_eq!(grid.len(), SAMPLES);
        for axis in 0..2 {
            let mut places: Vec<f32> = grid.iter().map(|(_, place)| place[axis] * SAMPLES as f32).collect();
            places.sort_by(f32::total_cmp);
            assert!(places.windows(2).all(|pair| (pair[1] - pair[0] - 1.0).abs() < 1e-3), "{places:?}");
        }
    }

    #[test]
    fn what_moves_by_a_little_changes_by_a_little() {
        let mesh = with_normals(&shapes::sphere(4)).into_owned();
        let asset = Asset::from_mesh("sphere", mesh.clone());
        let frame = Frame::around(&asset, false);
        let mut scene = Scene::new(&asset, &frame);
        let camera = Camera::at(Vec3::Z, 9.0, 400.0, (96, 96));
        let still = draw_plain(&scene, &camera);
        let mut moved = MorphedMesh::new(&mesh);
        scene.set(&moved, &frame);
        assert!(draw_plain(&scene, &camera) == still, "the mesh is where it was");
        // a twentieth of a pixel
        moved.positions.iter_mut().for_each(|p| p[0] += 0.05 * 9.0 / 400.0 * 1.7);
        scene.set(&moved, &frame);
        let largest =
            |a: &[Vec3], b: &[Vec3]| a.iter().zip(b).map(|(a, b)| (a - b).abs().max_element()).fold(0.0, f32::max);
        let change = largest(&draw_plain(&scene, &camera), &still);
        assert!(change > 1e-3 && change < 0.1, "{change}");
        assert!(largest(&still, &[BACKDROP; 96 * 96]) > 0.2);
    }
}
