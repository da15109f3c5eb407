//! Sample meshes made in code: what a newcomer sees first, and what tests and benchmarks run on without any download.
//!
//! All are in metres, y up, facing +z, and deterministic: the same arguments give the same bits on every run and with
//! any number of threads.

mod character;
mod distance;
mod isosurface;
mod mechanical;
mod noise;
mod part;
mod sample;
mod statue;
mod terrain;
#[cfg(test)]
mod testing;
mod vase;

pub use character::{Character, character};
pub use mechanical::mechanical;
pub use sample::Sample;
pub use statue::statue;
pub use terrain::terrain;
pub use vase::vase;

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Mesh;

    #[test]
    fn samples_are_the_same_with_any_number_of_threads() {
        let make =
            || -> [Mesh; 5] { [character(5000).mesh, statue(5000), mechanical(5000), terrain(2000), vase(5000)] };
        let with_threads = |threads| {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
            pool.install(make)
        };
        let alone = with_threads(1);
        for mesh in &alone {
            mesh.check().unwrap();
            let floats = mesh.wedge_attributes.iter().filter_map(|attribute| attribute.as_f32()).flatten();
            assert!(mesh.positions.iter().flatten().chain(floats).all(|x| x.is_finite()));
        }
        assert!(alone == with_threads(3));
    }

    #[test]
    fn samples_are_found_by_their_names() {
        for sample in Sample::ALL {
            assert_eq!(Sample::from_name(sample.name()), Some(sample));
        }
        assert_eq!(Sample::from_name("unicorn"), None);
    }
}
