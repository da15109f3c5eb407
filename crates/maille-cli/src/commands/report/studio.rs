//! Pictures of an asset and of what became of it: the same frame, the same cameras, the same lamps.

use std::borrow::Cow;

use maille::Mesh;
use maille::measure::heatmap;
use maille_io::Asset;

use super::percent;
use crate::output;
use crate::render::{Backdrop, Camera, Frame, Lighting, Scene, Style, draw};

/// How a picture shows a surface.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Look {
    /// Clay.
    Shaded,
    /// Facets and their edges.
    Wireframe,
    /// Its own colours and textures.
    Colours,
    /// Coloured by distances.
    Error,
}

impl Look {
    pub(crate) const ALL: [Self; 4] = [Self::Shaded, Self::Wireframe, Self::Colours, Self::Error];

    /// Class on the page.
    pub(crate) fn id(self) -> &'static str {
        match self {
            Self::Shaded => "shaded",
            Self::Wireframe => "wireframe",
            Self::Colours => "colours",
            Self::Error => "error",
        }
    }

    /// For people.
    pub(crate) fn name(self) -> &'static str {
        match self {
            Self::Shaded => "Shaded",
            Self::Wireframe => "Wireframe",
            Self::Colours => "Colours",
            Self::Error => "Error",
        }
    }

    fn style(self) -> Style {
        let wireframe = self == Self::Wireframe;
        let clay = matches!(self, Self::Shaded | Self::Wireframe);
        Style { flat: wireframe, wireframe, clay, backdrop: Backdrop::Transparent }
    }
}

/// The original, and from where it is looked at.
pub(crate) struct Studio<'a> {
    /// Everything that is drawn, as one mesh.
    pub(crate) surface: Cow<'a, Mesh>,
    /// The original, ready to be drawn.
    pub(crate) original: Model,
    frame: Frame,
    cameras: Vec<Camera>,
}

/// Something to draw, under the lamps of each camera.
pub(crate) struct Model {
    scene: Scene,
    lighting: Vec<Lighting>,
}

impl<'a> Studio<'a> {
    /// Sets up a camera to each view (degrees around the vertical axis, and above the horizon).
    pub(crate) fn new(original: &'a Asset, z_up: bool, views: &[(f32, f32)], size: (u32, u32)) -> Self {
        let frame = Frame::around(original, z_up);
        let scene = Scene::new(original, &frame);
        let cameras: Vec<Camera> =
            (views.iter()).map(|&(yaw, pitch)| Camera::framing(&scene.points, size, yaw, pitch)).collect();
        let lighting = cameras.iter().map(|camera| Lighting::new(&scene, camera)).collect();
        Self { surface: original.flattened(), original: Model { scene, lighting }, frame, cameras }
    }

    /// Whether there are colours or textures worth a picture of their own.
    pub(crate) fn has_colours(&self) -> bool {
        self.original.scene.has_colours()
    }

    /// Puts an asset where the original stands.
    pub(crate) fn model(&self, asset: &Asset) -> Model {
        let scene = Scene::new(asset, &self.frame);
        let lighting = self.cameras.iter().map(|camera| Lighting::new(&scene, camera)).collect();
        Model { scene, lighting }
    }

    /// A picture (PNG) by one of the cameras.
    pub(crate) fn picture(&self, model: &Model, view: usize, look: Look) -> Vec<u8> {
        draw(&model.scene, &model.lighting[view], &self.cameras[view], &look.style()).to_png()
    }

    /// Pictures (PNG) by all cameras of a model whose surface has a distance at each vertex.
    pub(crate) fn heat(&self, model: &Model, surface: &Mesh, distances: &[f32], scale: &HeatScale) -> Vec<Vec<u8>> {
        let shares: Vec<f32> = distances.iter().map(|&distance| scale.share(f64::from(distance))).collect();
        let coloured = Asset::from_mesh("distances", heatmap(surface, &shares, [0.0, 1.0]));
        let scene = Scene::new(&coloured, &self.frame);
        let cameras = self.cameras.iter().zip(&model.lighting);
        cameras.map(|(camera, lighting)| draw(&scene, lighting, camera, &Look::Error.style()).to_png()).collect()
    }
}

/// Which colour means which distance.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct HeatScale {
    /// Below this, all is dark violet, and the scale is logarithmic; `None`: from zero on, in even steps.
    pub(crate) low: Option<f64>,
    /// From here on, all is yellow.
    pub(crate) high: f64,
    /// For labels in percent of it; `None`: labels in units of the model.
    pub(crate) diagonal: Option<f64>,
}

impl HeatScale {
    /// A linear scale in units of the model that ends at a round number beyond nearly all (99 %) of the distances.
    pub(crate) fn covering<'a>(distances: impl IntoIterator<Item = &'a f32>) -> Self {
        let mut known: Vec<f32> = distances.into_iter().copied().filter(|d| d.is_finite()).collect();
        let rank = (known.len() * 99 / 100).min(known.len().saturating_sub(1));
        let most = match known.is_empty() {
            true => 0.0,
            false => f64::from(*known.select_nth_unstable_by(rank, f32::total_cmp).1),
        };
        Self { low: None, high: round_up(most), diagonal: None }
    }

    /// The place of a distance on the scale, 0 to 1.
    fn share(&self, distance: f64) -> f32 {
        match self.low {
            Some(low) => ((distance.max(low) / low).ln() / (self.high / low).ln()) as f32,
            None => (distance / self.high) as f32,
        }
    }

    /// Distances at even steps along the scale; the last one stands for all beyond, too.
    pub(crate) fn labels(&self) -> Vec<String> {
        let values: Vec<f64> = match self.low {
            Some(low) => {
                let decades = (self.high / low).log10().round() as i32;
                (0..=decades).map(|i| low * 10_f64.powi(i)).collect()
            }
            None => (0..=4).map(|i| self.high * f64::from(i) / 4.0).collect(),
        };
        let label = |&value: &f64| match self.diagonal {
            Some(diagonal) => percent(value / diagonal),
            None => output::number(value),
        };
        values.iter().map(label).collect()
    }

    /// What the labels are.
    pub(crate) fn meaning(&self) -> &'static str {
        match self.diagonal {
            Some(_) => "distance, in percent of the diagonal",
            None => "distance, in units of the model",
        }
    }
}

/// The next of 1, 2, 4 and 8 times a power of ten.
fn round_up(value: f64) -> f64 {
    if value <= 0.0 {
        return 1e-6;
    }
    let decade = 10_f64.powf(value.log10().floor());
    [1.0, 2.0, 4.0, 8.0].map(|step| step * decade).into_iter().find(|&step| step >= value).unwrap_or(10.0 * decade)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_scale_ends_beyond_nearly_all_distances() {
        let mut distances: Vec<f32> = (0..1000).map(|i| i as f32 / 1000.0 * 0.3).collect();
        distances.extend([50.0, f32::NAN]);
        let scale = HeatScale::covering(&distances);
        assert_eq!((scale.high, scale.share(0.1)), (0.4, 0.25));
        assert_eq!(scale.labels(), ["0", "0.1", "0.2", "0.3", "0.4"]);
        assert!(HeatScale::covering(&[]).high > 0.0 && HeatScale::covering(&[0.0, 0.0]).high > 0.0);
    }

    #[test]
    fn decades_are_labelled_in_percent() {
        let scale = HeatScale { low: Some(2e-6), high: 2e-2, diagonal: Some(2.0) };
        assert_eq!(scale.share(2e-4), 0.5);
        assert_eq!(scale.labels().len(), 5);
        assert_eq!(scale.labels()[4], "1\u{202f}%");
    }
}
