//! What the options about edge collapses mean, for all commands that have them.

use std::path::Path;
use std::sync::Arc;

use maille::simplify::{
    AttributeMetricKind, AttributeWeights, ColorSpace, EdgePolicy, MetricKind, PlacementKind, QuadricMemory,
    SimplifyError, SimplifyOptions, TopologyPolicy,
};
use maille_io::{Asset, AttributeRoles, CollapseOptions, Mask, MaskImage, ProcessError};

use crate::args::{CollapseArgs, Preset};
use crate::failure::Failure;

/// Share of the diagonal within which the aggressive preset joins parts.
const NEAR_PARTS: f64 = 0.001;
/// Extensions of images that may be masks.
const IMAGES: [&str; 3] = ["png", "jpg", "jpeg"];
/// Most pixels of a mask, along a side: what graphics cards take.
const MOST_PIXELS: u32 = 16_384;

/// Refuses options that do not go together.
pub(super) fn check(args: &CollapseArgs) -> Result<(), Failure> {
    let of_attributes =
        [("--color-space", args.color_space != "rgb"), ("--attribute-metric", args.attribute_metric != "gradients")];
    match of_attributes.iter().find(|(_, given)| *given && !attributes_count(args)) {
        None => Ok(()),
        Some((option, _)) => {
            let reason = "is for attributes that count, here the surface alone does; add --attributes";
            Err(Failure::Usage(format!("{option} {reason}")))
        }
    }
}

/// Whether attributes count in the metric.
fn attributes_count(args: &CollapseArgs) -> bool {
    args.attributes.unwrap_or(args.metric.is_none() || !args.attribute_weight.is_empty())
}

/// How each mesh of an asset with such a diagonal is to be simplified.
pub(super) fn simplify_options(args: &CollapseArgs, diagonal: f64) -> SimplifyOptions {
    let mut simplify = preset(args.preset);
    if let Some(metric) = args.metric.as_deref().and_then(|name| by_name(&MetricKind::NAMES, name)) {
        simplify.metric = metric;
    }
    if let Some(placement) = args.placement.as_deref().and_then(|name| by_name(&PlacementKind::NAMES, name)) {
        simplify.placement = placement;
    }
    simplify.quadric_weight = args.weights.into();
    simplify.memory = args.memory.as_deref().and_then(|name| by_name(&QuadricMemory::NAMES, name));
    simplify.position_sigma = args.position_sigma.unwrap_or(simplify.position_sigma);
    simplify.normal_sigma = args.normal_sigma.unwrap_or(simplify.normal_sigma);
    simplify.line_weight = args.line_weight.unwrap_or(simplify.line_weight);
    simplify.silhouette_weight = args.silhouette_weight;
    for (place, given) in [
        (&mut simplify.boundary, args.boundary),
        (&mut simplify.seams, args.seams),
        (&mut simplify.material_borders, args.material_borders),
    ] {
        if let Some(policy) = given {
            *place = policy.into();
        }
    }
    simplify.constraint_weight = args.constraint_weight;
    if let Some(topology) = args.topology.as_deref().and_then(|name| by_name(&TopologyPolicy::NAMES, name)) {
        simplify.topology = topology;
    }
    simplify.max_normal_turn = args.max_normal_turn.0.map(f64::to_radians);
    simplify.max_normal_deviation = args.max_normal_deviation.0.map(f64::to_radians);
    simplify.valence = args.valence;
    simplify.min_quality = args.min_quality;
    simplify.no_self_intersections = args.no_self_intersections;
    let near = (args.preset == Preset::Aggressive).then_some(NEAR_PARTS * diagonal);
    simplify.join_distance = args.join_distance.map(|distance| distance.in_units(diagonal)).or(near);
    simplify.normals = args.normals.into();
    simplify.max_influences = args.max_influences;
    if !attributes_count(args) {
        simplify.attributes = AttributeWeights::NONE;
    }
    simplify.attribute_metric = by_name(&AttributeMetricKind::NAMES, &args.attribute_metric).unwrap_or_default();
    simplify.color_space = by_name(&ColorSpace::NAMES, &args.color_space).unwrap_or_default();
    simplify.texture_may_fold = args.texture_may_fold;
    simplify
}

/// How the edges of an asset collapse, where that is recorded.
pub(super) fn options(args: &CollapseArgs, asset: &Asset) -> Result<CollapseOptions, Failure> {
    check(args)?;
    if args.preset == Preset::Fastest {
        return Err(Failure::Usage("--preset fastest clusters vertices, which makes no levels; leave it out".into()));
    }
    Ok(CollapseOptions {
        simplify: simplify_options(args, super::diagonal(asset)),
        roles: roles(args)?,
        weld: args.preset == Preset::Aggressive,
    })
}

/// What the attributes of the asset mean.
pub(super) fn roles(args: &CollapseArgs) -> Result<AttributeRoles, Failure> {
    let mask = |text: &Option<String>| text.as_deref().map(mask).transpose();
    Ok(AttributeRoles {
        weights: args.attribute_weight.clone(),
        max_texel_error: args.max_texel_error,
        importance: mask(&args.importance)?,
        lock: mask(&args.lock)?,
        region: mask(&args.region)?,
    })
}

/// An image, if the name ends like one; else an attribute.
fn mask(text: &str) -> Result<Mask, Failure> {
    let path = Path::new(text);
    let extension = path.extension().map(|extension| extension.to_string_lossy().to_lowercase());
    if !extension.is_some_and(|extension| IMAGES.contains(&extension.as_str())) {
        return Ok(Mask::Attribute(text.to_owned()));
    }
    let cannot = |error: &dyn std::fmt::Display| Failure::about(path, format!("the mask cannot be read: {error}"));
    let mut reader = image::ImageReader::open(path).map_err(|error| cannot(&error))?;
    let mut limits = image::Limits::default();
    (limits.max_image_width, limits.max_image_height) = (Some(MOST_PIXELS), Some(MOST_PIXELS));
    reader.limits(limits);
    let reader = reader.with_guessed_format().map_err(|error| cannot(&error))?;
    let grey = reader.decode().map_err(|error| cannot(&error))?.into_luma16();
    let values = grey.as_raw().iter().map(|&value| f32::from(value) / f32::from(u16::MAX)).collect();
    let image = MaskImage::new(grey.width() as usize, values).ok_or_else(|| cannot(&"it has no pixels"))?;
    Ok(Mask::Image(Arc::new(image)))
}

/// The bundle of options that a preset stands for.
pub(super) fn preset(preset: Preset) -> SimplifyOptions {
    let balanced = SimplifyOptions::default();
    match preset {
        // clusters, unless --method says otherwise
        Preset::Fastest | Preset::Balanced => balanced,
        Preset::Fast => SimplifyOptions { metric: MetricKind::ConstrainedQuadric, ..balanced },
        Preset::Best => balanced,
        Preset::Aggressive => SimplifyOptions {
            boundary: EdgePolicy::Hold,
            topology: TopologyPolicy::Free,
            join_parts_only: true,
            ..balanced
        },
    }
}

pub(super) fn by_name<T: Copy>(names: &[(&str, T)], name: &str) -> Option<T> {
    names.iter().find(|(known, _)| *known == name).map(|&(_, value)| value)
}

pub(super) fn name_of<T: PartialEq>(names: &[(&'static str, T)], value: &T) -> &'static str {
    names.iter().find(|(_, known)| known == value).map_or("", |&(name, _)| name)
}

/// Why a file could not be simplified, for the user.
pub(super) fn refusal(path: &Path, error: &ProcessError) -> Failure {
    let path = path.display();
    match error {
        ProcessError::Mesh { error: SimplifyError::Cancelled(_), .. } => Failure::Cancelled,
        ProcessError::Mesh { error: SimplifyError::NotFinite { .. }, .. } => {
            Failure::Refused(format!("cannot simplify {path}: {error} (maille repair {path} -o OUT --all)"))
        }
        ProcessError::Mesh { error: SimplifyError::InvalidOption { name: "poses", .. }, .. } => {
            let remedy = "--poses bind looks at the surface as it is stored, with any metric";
            Failure::Refused(format!("cannot simplify {path}: {error} ({remedy})"))
        }
        ProcessError::NoTexture => {
            Failure::Refused(format!("cannot simplify {path}: {error} (leave out --max-texel-error)"))
        }
        _ => Failure::Refused(format!("cannot simplify {path}: {error}")),
    }
}
