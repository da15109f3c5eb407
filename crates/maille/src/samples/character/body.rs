//! The shape: cones, balls and their fillets, each carried by a joint and made of a material.

use glam::Vec3;

use super::rig;
use crate::samples::distance::{ellipsoid, join, round_cone};
use crate::samples::noise::{fractal, gradient, smoothstep};

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Material {
    Skin,
    Hair,
    Shirt,
    Trousers,
    Shoe,
}

/// What has one colour, with crisp borders to its neighbours.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub(super) enum Region {
    Skin,
    Lips,
    Brow,
    EyeWhite,
    Iris,
    Hair,
    Shirt,
    Stripe,
    Trousers,
    Belt,
    Shoe,
    Tongue,
    Sole,
}

#[derive(Debug, Clone, Copy)]
enum Shape {
    /// The hull of two spheres.
    Cone {
        a: Vec3,
        b: Vec3,
        ra: f32,
        rb: f32,
    },
    /// The same, flattened: z is divided by the last number.
    Flat {
        a: Vec3,
        b: Vec3,
        ra: f32,
        rb: f32,
        depth: f32,
    },
    Ball {
        centre: Vec3,
        radii: Vec3,
    },
}

impl Shape {
    fn distance(&self, p: Vec3) -> f32 {
        match *self {
            Self::Cone { a, b, ra, rb } => round_cone(p, a, b, ra, rb),
            Self::Flat { a, b, ra, rb, depth } => {
                let squeezed = |q: Vec3| Vec3::new(q.x, q.y, q.z / depth);
                depth.min(1.0) * round_cone(squeezed(p), squeezed(a), squeezed(b), ra, rb)
            }
            Self::Ball { centre, radii } => ellipsoid(p - centre, radii),
        }
    }
}

#[derive(Debug, Clone, Copy)]
struct Part {
    joint: usize,
    material: Material,
    shape: Shape,
    /// Size of the fillet towards the parts before.
    fillet: f32,
}

/// The parts of the left half; the right half mirrors it.
pub(super) struct Body {
    parts: Vec<Part>,
}

fn v(x: f32, y: f32, z: f32) -> Vec3 {
    Vec3::new(x, y, z)
}

impl Body {
    pub(super) fn new() -> Self {
        let mut body = Self { parts: Vec::new() };
        body.torso();
        body.leg();
        body.arm();
        body.hand();
        body.head();
        body
    }

    fn add(&mut self, joint: &str, material: Material, fillet: f32, shape: Shape) {
        self.parts.push(Part { joint: rig::joint(joint), material, shape, fillet });
    }

    fn torso(&mut self) {
        use Material::{Shirt, Trousers};
        let flat = |a, b, ra, rb, depth| Shape::Flat { a, b, ra, rb, depth };
        let cone = |a, b, ra, rb| Shape::Cone { a, b, ra, rb };
        let chest = flat(v(0.062, 1.315, -0.012), v(0.055, 1.205, -0.008), 0.112, 0.100, 0.86);
        self.add(
            "upper_chest",
            Shirt,
            0.05,
            flat(v(0.070, 1.345, -0.014), v(0.062, 1.300, -0.012), 0.100, 0.112, 0.88),
        );
        self.add("chest", Shirt, 0.05, chest);
        self.add("spine", Shirt, 0.05, flat(v(0.050, 1.180, -0.006), v(0.046, 1.075, 0.0), 0.098, 0.094, 0.90));
        self.add("spine", Shirt, 0.04, flat(v(0.046, 1.080, 0.0), v(0.055, 0.985, 0.0), 0.094, 0.108, 0.95));
        self.add("hips", Trousers, 0.03, flat(v(0.052, 1.000, 0.0), v(0.060, 0.930, -0.004), 0.098, 0.100, 0.95));
        self.add(
            "hips",
            Trousers,
            0.04,
            Shape::Ball { centre: v(0.062, 0.925, -0.050), radii: v(0.082, 0.088, 0.070) },
        );
        let pectoral = Shape::Ball { centre: v(0.066, 1.318, 0.052), radii: v(0.078, 0.060, 0.042) };
        self.add("upper_chest", Shirt, 0.05, pectoral);
        self.add("clavicle_l", Shirt, 0.05, cone(v(0.030, 1.425, -0.025), v(0.140, 1.398, -0.018), 0.046, 0.052));
    }

    fn leg(&mut self) {
        use Material::{Shoe, Trousers};
        let cone = |a, b, ra, rb| Shape::Cone { a, b, ra, rb };
        self.add("thigh_l", Trousers, 0.05, cone(v(0.094, 0.905, 0.0), v(0.100, 0.520, 0.008), 0.092, 0.062));
        self.add("shin_l", Trousers, 0.03, cone(v(0.100, 0.505, 0.010), v(0.104, 0.330, -0.010), 0.061, 0.058));
        self.add("shin_l", Trousers, 0.04, cone(v(0.104, 0.350, -0.016), v(0.105, 0.130, -0.024), 0.058, 0.051));
        self.add("foot_l", Shoe, 0.008, cone(v(0.105, 0.110, -0.028), v(0.105, 0.055, -0.040), 0.043, 0.043));
        let instep =
            Shape::Flat { a: v(0.105, 0.052, -0.040), b: v(0.112, 0.040, 0.075), ra: 0.043, rb: 0.042, depth: 1.0 };
        self.add("foot_l", Shoe, 0.02, instep);
        self.add("foot_l", Shoe, 0.03, cone(v(0.106, 0.095, -0.015), v(0.112, 0.050, 0.060), 0.036, 0.032));
        self.add("toes_l", Shoe, 0.02, Shape::Ball { centre: v(0.114, 0.030, 0.112), radii: v(0.049, 0.040, 0.068) });
    }

    fn arm(&mut self) {
        use Material::{Shirt, Skin};
        let cone = |a, b, ra, rb| Shape::Cone { a, b, ra, rb };
        let [shoulder, elbow, wrist] = ["upper_arm_l", "forearm_l", "hand_l"].map(|name| rig::place(rig::joint(name)));
        let sleeve = shoulder.lerp(elbow, 0.52);
        self.add("upper_arm_l", Shirt, 0.05, cone(shoulder, sleeve, 0.064, 0.059));
        self.add("upper_arm_l", Skin, 0.006, cone(shoulder.lerp(elbow, 0.3), elbow, 0.049, 0.039));
        self.add("forearm_l", Skin, 0.03, cone(elbow, elbow.lerp(wrist, 0.30) + v(0.0, 0.0, -0.002), 0.040, 0.042));
        self.add("forearm_l", Skin, 0.03, cone(elbow.lerp(wrist, 0.25), wrist, 0.042, 0.0285));
    }

    /// A hand whose thumb points forward, its fingers a little bent and spread.
    fn hand(&mut self) {
        use Material::Skin;
        let cone = |a, b, ra, rb| Shape::Cone { a, b, ra, rb };
        let [wrist, knuckles] = ["hand_l", "fingers_l"].map(|name| rig::place(rig::joint(name)));
        let along = (knuckles - wrist).normalize();
        // towards the palm, away from the back of the hand
        let palm = along.cross(Vec3::Z).normalize();
        let across = palm.cross(along).normalize();
        let at = |x: f32, side: f32, down: f32| wrist + along * x + across * side + palm * down;
        self.add("hand_l", Skin, 0.02, cone(at(0.0, 0.002, 0.0), at(0.078, 0.024, 0.0), 0.026, 0.0165));
        self.add("hand_l", Skin, 0.02, cone(at(0.0, -0.002, 0.0), at(0.074, -0.022, 0.002), 0.026, 0.0155));
        self.add("hand_l", Skin, 0.02, cone(at(0.02, 0.0, 0.004), at(0.078, 0.001, 0.0), 0.024, 0.0165));
        // the webs between the fingers
        self.add("hand_l", Skin, 0.008, cone(at(0.086, 0.034, 0.001), at(0.082, -0.030, 0.002), 0.0125, 0.0120));
        let fingers =
            [(0.0375, 0.072, 0.0098), (0.0125, 0.082, 0.0102), (-0.0125, 0.077, 0.0098), (-0.0375, 0.060, 0.0088)];
        for (side, length, radius) in fingers {
            let base = at(0.082 - 4.0 * side * side, side, 0.0);
            let middle = at(0.085 + 0.46 * length, side * 1.30, 0.006);
            let tip = at(0.083 + 0.94 * length, side * 1.48, 0.021);
            self.add("fingers_l", Skin, 0.004, cone(base, middle, radius + 0.0004, radius));
            self.add("finger_tips_l", Skin, 0.003, cone(middle, tip, radius, radius - 0.0018));
        }
        // the web beside the thumb
        self.add("hand_l", Skin, 0.012, cone(at(0.020, 0.020, 0.006), at(0.054, 0.034, 0.006), 0.018, 0.011));
        self.add("thumb_l", Skin, 0.018, cone(at(0.016, 0.022, 0.008), at(0.044, 0.056, 0.014), 0.0165, 0.0125));
        self.add("thumb_l", Skin, 0.004, cone(at(0.044, 0.056, 0.014), at(0.070, 0.076, 0.018), 0.0122, 0.0102));
    }

    fn head(&mut self) {
        use Material::{Hair, Skin};
        let cone = |a, b, ra, rb| Shape::Cone { a, b, ra, rb };
        let ball = |centre, radii| Shape::Ball { centre, radii };
        self.add("neck", Skin, 0.012, cone(v(0.0, 1.452, -0.018), v(0.0, 1.560, 0.0), 0.055, 0.052));
        self.add("head", Skin, 0.02, ball(v(0.0, 1.660, 0.0), v(0.082, 0.102, 0.100)));
        self.add("head", Skin, 0.04, ball(v(0.0, 1.600, 0.030), v(0.060, 0.066, 0.068)));
        self.add("head", Skin, 0.02, ball(v(0.0, 1.552, 0.072), v(0.028, 0.020, 0.022)));
        // cheeks, brows, nose with its wings, lips
        self.add("head", Skin, 0.03, ball(v(0.042, 1.618, 0.056), v(0.028, 0.030, 0.030)));
        self.add("head", Skin, 0.02, cone(v(0.014, 1.672, 0.092), v(0.046, 1.674, 0.074), 0.0095, 0.0085));
        self.add("head", Skin, 0.014, cone(v(0.0, 1.664, 0.096), v(0.0, 1.629, 0.117), 0.0085, 0.0115));
        self.add("head", Skin, 0.008, ball(v(0.0105, 1.624, 0.105), v(0.0095, 0.0080, 0.0110)));
        self.add("head", Skin, 0.008, ball(v(0.0, 1.5875, 0.0925), v(0.0270, 0.0055, 0.0110)));
        self.add("head", Skin, 0.008, ball(v(0.0, 1.5775, 0.0905), v(0.0230, 0.0062, 0.0115)));
        self.add("head", Skin, 0.010, ball(v(0.085, 1.640, -0.008), v(0.013, 0.032, 0.021)));
        self.add("head", Skin, 0.003, ball(EYE, v(0.0180, 0.0150, 0.0160)));
        self.add("head", Hair, 0.004, ball(v(0.0, 1.680, -0.016), v(0.0945, 0.1010, 0.1080)));
        self.add("head", Hair, 0.020, ball(v(0.030, 1.745, 0.052), v(0.055, 0.034, 0.050)));
        self.add("head", Hair, 0.030, ball(v(0.0, 1.625, -0.060), v(0.070, 0.070, 0.052)));
    }

    /// Signed distance to the whole body.
    pub(super) fn distance(&self, p: Vec3) -> f32 {
        let m = v(p.x.abs(), p.y, p.z);
        let mut sum = f32::INFINITY;
        for part in &self.parts {
            sum = join(sum, part.distance(m, p), part.fillet);
        }
        // sockets for the eyes, folds in the cloth, and a flat sole
        let details = if m.y > 1.5 { socket(m) } else { folds(m, p) };
        (sum + details).max(-p.y)
    }

    /// Distance to what one joint carries, without fillets; infinite when that is nothing.
    pub(super) fn joint_distance(&self, joint: usize, p: Vec3) -> f32 {
        // a joint in the middle carries both halves, one at a side only that one
        let is_middle = rig::twin(joint) == joint;
        let is_right = rig::place(joint).x < 0.0;
        let m = match (is_middle, is_right) {
            (true, _) => v(p.x.abs(), p.y, p.z),
            (false, true) => v(-p.x, p.y, p.z),
            (false, false) => p,
        };
        let left = if is_right { rig::twin(joint) } else { joint };
        let distances = self.parts.iter().filter(|part| part.joint == left).map(|part| part.distance(m, p));
        distances.fold(f32::INFINITY, f32::min)
    }

    /// What is at a point of the surface.
    pub(super) fn region(&self, p: Vec3) -> Region {
        let m = v(p.x.abs(), p.y, p.z);
        let nearest = |a: &&Part, b: &&Part| a.distance(m, p).total_cmp(&b.distance(m, p));
        let part = self.parts.iter().min_by(nearest).expect("the body has parts");
        match part.material {
            Material::Skin => face_region(m),
            Material::Hair => Region::Hair,
            Material::Shirt if (p.y - 1.245).abs() < 0.024 && m.x < 0.22 => Region::Stripe,
            Material::Shirt => Region::Shirt,
            Material::Trousers if p.y > 0.988 => Region::Belt,
            Material::Trousers => Region::Trousers,
            Material::Shoe if p.y < 0.020 => Region::Sole,
            Material::Shoe if p.y > 0.058 && p.z > 0.012 && (m.x - 0.109).abs() < 0.027 => Region::Tongue,
            Material::Shoe => Region::Shoe,
        }
    }

    /// Linear colour of a region at a point.
    pub(super) fn color(&self, region: Region, p: Vec3) -> Vec3 {
        let m = v(p.x.abs(), p.y, p.z);
        let weave = 1.0 + 0.10 * fractal(p * 60.0, 2, 83);
        match region {
            Region::Skin => skin_color(m),
            Region::Lips => v(0.400, 0.135, 0.110),
            Region::Brow => v(0.060, 0.027, 0.013),
            Region::EyeWhite => v(0.780, 0.760, 0.720),
            Region::Iris => v(0.030, 0.016, 0.008),
            Region::Hair => v(0.055, 0.024, 0.011) * (1.0 + 0.5 * strands(p)),
            Region::Shirt => v(0.440, 0.052, 0.036) * weave,
            Region::Stripe => v(0.720, 0.660, 0.550) * weave,
            Region::Trousers => trousers_color(m, p),
            Region::Belt => v(0.060, 0.028, 0.013),
            Region::Shoe => v(0.090, 0.095, 0.100),
            Region::Tongue => v(0.550, 0.530, 0.500),
            Region::Sole => v(0.750, 0.730, 0.700),
        }
    }
}

impl Part {
    fn is_trunk(&self) -> bool {
        matches!(self.material, Material::Shirt | Material::Trousers) && rig::twin(self.joint) == self.joint
    }

    /// `m` is the point mirrored to the left half, `p` the point itself (hair is not symmetric).
    fn distance(&self, m: Vec3, p: Vec3) -> f32 {
        if self.is_trunk() {
            // round where the halves meet, or a crease would run down the chest
            return self.shape.distance(v((m.x * m.x + 0.0006).sqrt(), m.y, m.z));
        }
        let distance = self.shape.distance(m);
        if self.material != Material::Hair || distance > 0.03 {
            return distance;
        }
        // the hairline: forehead, temple before the ear, nape
        let line = (1.712 - 0.030 * smoothstep(0.0, 0.06, -p.x) - p.y).max((p.z - 0.018) * 0.9 + (1.66 - p.y) * 0.55);
        let nape = 1.585 - p.y;
        (distance + 0.004 * strands(p)).max((p.z - 0.020).min(line)).max(nape)
    }
}

/// Centre of the left eye.
const EYE: Vec3 = Vec3::new(0.0325, 1.6490, 0.0775);

/// Strands of hair, combed to the side: -1 to 1.
fn strands(p: Vec3) -> f32 {
    fractal(v(p.x * 30.0 + 40.0 * p.y, p.y * 12.0, p.z * 70.0 - p.x * 30.0), 2, 81)
}

/// The hollow around the eye.
fn socket(m: Vec3) -> f32 {
    let from = (m - v(0.034, 1.650, 0.096)) / v(0.026, 0.017, 0.03);
    0.004 * smoothstep(1.0, 0.3, from.length()) * smoothstep(0.016, 0.020, m.distance(EYE))
}

/// Folds in shirt and trousers, deepest where cloth hangs loose; hems.
fn folds(m: Vec3, p: Vec3) -> f32 {
    let waist = smoothstep(0.98, 1.01, p.y) * smoothstep(1.22, 1.05, p.y);
    let knee = smoothstep(0.33, 0.45, p.y) * smoothstep(0.62, 0.5, p.y);
    let ankle = smoothstep(0.08, 0.12, p.y) * smoothstep(0.28, 0.16, p.y);
    let is_trunk = smoothstep(0.25, 0.2, m.x);
    let loose = is_trunk * (0.6 * waist + 0.5 * knee + ankle);
    if loose <= 0.0 {
        return 0.0;
    }
    loose * 0.005 * gradient(v(p.x * 12.0, p.y * 34.0, p.z * 12.0), 82)
}

/// Skin and what is painted on it in the face.
fn face_region(m: Vec3) -> Region {
    if m.y < 1.55 || m.z < 0.04 {
        return Region::Skin;
    }
    let eye = (m - EYE) / v(0.0178, 0.0100, 0.03);
    let iris = v(m.x - EYE.x, m.y - EYE.y, 0.0);
    let arch = m.y - (1.6815 - 12.0 * (m.x - 0.034) * (m.x - 0.034));
    let mouth = (m - v(0.0, 1.5825, 0.100)) / v(0.0265, 0.0108, 0.04);
    if eye.length() < 1.0 {
        if iris.length() < 0.0078 { Region::Iris } else { Region::EyeWhite }
    } else if arch.abs() < 0.0046 && (0.013..0.056).contains(&m.x) {
        Region::Brow
    } else if mouth.length() < 1.0 {
        Region::Lips
    } else {
        Region::Skin
    }
}

fn skin_color(m: Vec3) -> Vec3 {
    let skin = v(0.560, 0.300, 0.195);
    let flush = v(0.560, 0.220, 0.140);
    let cheek = smoothstep(0.040, 0.0, m.distance(v(0.048, 1.612, 0.085)));
    let lid = smoothstep(0.030, 0.020, m.distance(EYE)) * smoothstep(0.05, 0.06, m.z);
    skin.lerp(flush, 0.5 * cheek).lerp(v(0.36, 0.17, 0.11), 0.45 * lid)
}

fn trousers_color(m: Vec3, p: Vec3) -> Vec3 {
    let denim = v(0.030, 0.055, 0.120);
    let worn = 0.5 * smoothstep(0.16, 0.0, (p.y - 0.60).abs()) * smoothstep(0.0, 0.07, p.z);
    let seam = smoothstep(0.014, 0.004, p.z.abs()) * smoothstep(0.11, 0.14, m.x);
    let cloth = denim.lerp(v(0.10, 0.15, 0.25), worn).lerp(v(0.02, 0.03, 0.06), seam);
    cloth * (1.0 + 0.25 * fractal(p * 90.0, 2, 84))
}
