//! Options about how edges collapse, shared by all commands that let them.

use clap::{Args, ValueEnum};
use maille::simplify::{EdgePolicy, NormalPolicy, QuadricWeight};

use super::{
    Distance, MEMORIES, METRICS, PLACEMENTS, TOPOLOGIES, named, parse_distance, parse_non_negative, parse_range,
    parse_turn, parse_unit, parse_weight,
};

// a comment of the documentation would become the help of the commands
#[derive(Debug, Args)]
pub(crate) struct CollapseArgs {
    /// A bundle of method, metric and placement; the options below override its parts.
    #[arg(long, value_enum, default_value_t = Preset::Balanced, help_heading = "Method")]
    pub(crate) preset: Preset,
    /// What a collapse costs.
    #[arg(long, value_name = "NAME", value_parser = named(&METRICS), help_heading = "Method")]
    pub(crate) metric: Option<String>,
    /// Where the merged vertex goes.
    #[arg(long, value_name = "NAME", value_parser = named(&PLACEMENTS), help_heading = "Method")]
    pub(crate) placement: Option<String>,
    /// How the triangles' planes are weighted in quadric metrics.
    #[arg(long, value_enum, default_value_t = Weights::Area, help_heading = "Method")]
    pub(crate) weights: Weights,
    /// What quadrics know of the past. summed: all planes of the original; rebuilt: those of the triangles as they are;
    /// both: rebuilt ones place, both cost. Default: what the metric is named after.
    #[arg(long, value_name = "MEMORY", value_parser = named(&MEMORIES), help_heading = "Method")]
    pub(crate) memory: Option<String>,
    /// Standard deviation of positions for the probabilistic metrics, in mean edge lengths; default: 0.01.
    #[arg(long, value_name = "S", value_parser = parse_non_negative, help_heading = "Method")]
    pub(crate) position_sigma: Option<f64>,
    /// Standard deviation of unit normals for probabilistic-plane; default: 0.01.
    #[arg(long, value_name = "S", value_parser = parse_non_negative, help_heading = "Method")]
    pub(crate) normal_sigma: Option<f64>,
    /// Weight of the lines in line-quadrics, relative to the planes; default: 0.001.
    #[arg(long, value_name = "W", value_parser = parse_non_negative, help_heading = "Method")]
    pub(crate) line_weight: Option<f64>,
    /// How much more collapses cost where the model's outline is likely to be seen: 0.2 is what to begin with.
    #[arg(long, value_name = "W", default_value_t = 0.0, value_parser = parse_non_negative, help_heading = "Method")]
    pub(crate) silhouette_weight: f64,

    /// What happens to open borders; default: preserve.
    #[arg(long, value_enum, value_name = "POLICY", help_heading = "Constraints")]
    pub(crate) boundary: Option<Border>,
    /// What happens to edges where an attribute (normal, texture coordinate, colour) jumps; default: hold.
    #[arg(long, value_enum, value_name = "POLICY", help_heading = "Constraints")]
    pub(crate) seams: Option<Border>,
    /// What happens to edges between two materials; default: hold.
    #[arg(long, value_enum, value_name = "POLICY", help_heading = "Constraints")]
    pub(crate) material_borders: Option<Border>,
    /// How strongly preserved edges are held: 1 counts as much as a square of the edge's length.
    #[arg(long, value_name = "W", default_value_t = 1.0, value_parser = parse_non_negative, help_heading = "Constraints")]
    pub(crate) constraint_weight: f64,
    /// What collapses may do to the topology. preserve: nothing; manifold: close holes of three edges, drop the last
    /// triangles of a component; free: anything, non-manifold edges too. Default: manifold.
    #[arg(long, value_name = "POLICY", value_parser = TOPOLOGIES, help_heading = "Constraints")]
    pub(crate) topology: Option<String>,
    /// Refuse collapses that turn a triangle's normal by more than this angle in degrees; `off`: allow all.
    #[arg(long, value_name = "DEG", default_value = "75", value_parser = parse_turn, help_heading = "Constraints")]
    pub(crate) max_normal_turn: Turn,
    /// Refuse collapses after which a triangle's normal deviates by more than this angle in degrees from those of the
    /// original triangles that it stands for; `off`: allow all.
    #[arg(long, value_name = "DEG", default_value = "off", value_parser = parse_turn, help_heading = "Constraints")]
    pub(crate) max_normal_deviation: Turn,
    /// Refuse collapses that leave a vertex with a valence outside this range, for example 4..11.
    #[arg(long, value_name = "LOW..HIGH", value_parser = parse_range, help_heading = "Constraints")]
    pub(crate) valence: Option<(u32, u32)>,
    /// Refuse collapses that make a triangle worse than before and than this quality (1: equilateral, 0: needle).
    #[arg(long, value_name = "Q", value_parser = parse_unit, help_heading = "Constraints")]
    pub(crate) min_quality: Option<f64>,
    /// Refuse collapses after which the surface would pass through itself. Takes four to five times as long; --refit,
    /// which does not know of it, is left out.
    #[arg(long, help_heading = "Constraints")]
    pub(crate) no_self_intersections: bool,
    /// Also join vertices without an edge between them that are closer than this: units, or a share of the diagonal.
    #[arg(long, value_name = "D", value_parser = parse_distance, help_heading = "Constraints")]
    pub(crate) join_distance: Option<Distance>,
    /// Take the importance of vertices from an attribute: a factor on the cost of their collapses. Of a colour, the
    /// brightness counts: black is neutral (1), white is 100. Or from an image (.png, .jpg) that is painted over the texture
    /// coordinates, in the same way.
    #[arg(long, value_name = "ATTRIBUTE|IMAGE", help_heading = "Constraints")]
    pub(crate) importance: Option<String>,
    /// Keep the vertices where this attribute is above one half, or where this image is brighter.
    #[arg(long, value_name = "ATTRIBUTE|IMAGE", help_heading = "Constraints")]
    pub(crate) lock: Option<String>,
    /// Simplify only where this attribute is above one half, or where this image is brighter.
    #[arg(long, value_name = "ATTRIBUTE|IMAGE", help_heading = "Constraints")]
    pub(crate) region: Option<String>,

    /// Whether normals, texture coordinates, colours and other attributes count in the metric besides the surface.
    /// Default: yes, unless --metric names one: these are of the surface alone.
    #[arg(long, value_name = "yes|no", num_args = 0..=1, default_missing_value = "yes", require_equals = true,
        value_parser = clap::builder::BoolishValueParser::new(), help_heading = "Attributes")]
    pub(crate) attributes: Option<bool>,
    /// What an attribute counts in the metric: a factor on its automatic weight, for example normal=2 or COLOR_0=0. May be
    /// given several times.
    #[arg(long, value_name = "NAME=FACTOR", value_parser = parse_weight, help_heading = "Attributes")]
    pub(crate) attribute_weight: Vec<(String, f64)>,
    /// Refuse collapses after which the texture has slipped by more than so many texels of the base colour texture, by the
    /// estimate of the metric.
    #[arg(long, value_name = "TEXELS", value_parser = parse_non_negative, help_heading = "Attributes")]
    pub(crate) max_texel_error: Option<f64>,
    /// In which space differences of colours count, where they do: as stored, or CIE L*a*b*, where equal differences look equal.
    #[arg(long, value_name = "rgb|lab", default_value = "rgb", value_parser = ["rgb", "lab"], help_heading = "Attributes")]
    pub(crate) color_space: String,
    /// How attributes enter the metric, where they count: by their gradients over the surface (Hoppe 1999), or by distances in
    /// the space of positions and attributes together (Garland and Heckbert 1998; for comparison).
    #[arg(long, value_name = "KIND", default_value = "gradients", value_parser = ["gradients", "generalized-quadric"],
        help_heading = "Attributes")]
    pub(crate) attribute_metric: String,
    /// Let triangles be turned over in the texture.
    #[arg(long, help_heading = "Attributes")]
    pub(crate) texture_may_fold: bool,
    /// How the normals of merged vertices come about where they do not count in the metric.
    #[arg(long, value_enum, default_value_t = Normals::Interpolate, help_heading = "Attributes")]
    pub(crate) normals: Normals,
    /// Most joints that move one vertex; default: as many as the file has room for.
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..), help_heading = "Attributes")]
    pub(crate) max_influences: Option<u32>,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub(crate) enum Preset {
    /// Vertex clustering by quadrics: many times as fast, a larger error, any topology
    Fastest,
    /// Summed quadrics with constraints, the best place
    Fast,
    /// Hybrid quadrics, the best place that keeps the volume
    Balanced,
    /// As balanced, fitted to the original in the end
    Best,
    /// As balanced, but borders and topology may go: reaches the smallest counts
    Aggressive,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub(crate) enum Weights {
    /// Every plane the same
    Uniform,
    /// By the area of the triangle
    Area,
    /// By the square of the area of the triangle
    AreaSquared,
    /// By the angle of the triangle at the vertex
    Angle,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub(crate) enum Border {
    /// Nothing special
    Free,
    /// Planes make it costly to leave them, nothing is forbidden
    Hold,
    /// Collapse along themselves only
    Preserve,
    /// Their vertices stay
    Lock,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub(crate) enum Normals {
    /// Interpolated along the edge
    Interpolate,
    /// The mean of the triangles around, by angle
    Recompute,
}

/// The largest turn of a normal, in degrees; `None`: any.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Turn(pub(crate) Option<f64>);

impl From<Weights> for QuadricWeight {
    fn from(weights: Weights) -> Self {
        match weights {
            Weights::Uniform => Self::Uniform,
            Weights::Area => Self::Area,
            Weights::AreaSquared => Self::AreaSquared,
            Weights::Angle => Self::Angle,
        }
    }
}

impl From<Border> for EdgePolicy {
    fn from(border: Border) -> Self {
        match border {
            Border::Free => Self::Free,
            Border::Hold => Self::Hold,
            Border::Preserve => Self::Preserve,
            Border::Lock => Self::Lock,
        }
    }
}

impl From<Normals> for NormalPolicy {
    fn from(normals: Normals) -> Self {
        match normals {
            Normals::Interpolate => Self::Interpolate,
            Normals::Recompute => Self::Recompute,
        }
    }
}
