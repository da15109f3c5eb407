//! Pictures without a graphics card: a small software renderer for reports and the documentation.
//!
//! [`Scene`] is what to draw, [`Camera`] from where, [`Style`] how; [`draw`] gives a [`Picture`]. Light comes from many
//! directional lamps (a sky dome and a cluster for the key light), each with a depth map: their sum gives soft shadows
//! and ambient occlusion by one mechanism. [`draw_plain`] is for pictures that are measured instead of looked at: no shadows,
//! and nothing that jumps where the scene moves a little. The same input gives the same pixels with any number of threads.

mod camera;
mod colour;
mod light;
mod picture;
mod plain;
mod raster;
mod scene;
mod shade;

pub(crate) use camera::Camera;
pub(crate) use colour::encoded;
pub(crate) use light::Lighting;
pub(crate) use picture::Picture;
pub(crate) use plain::draw_plain;
pub(crate) use scene::{Frame, Scene, with_normals};
pub(crate) use shade::{Backdrop, Style, draw};
