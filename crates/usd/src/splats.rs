//! Converts particle fields to clouds of Gaussian splats.

use glam::{Quat, Vec3};
use lumistack_core::Task;
use lumistack_scene::{Cloud, Encoding, MAX_DEGREE};

use crate::error::Fault;
use crate::package::{Array, Package, SplatsEntry};

/// Returns the cloud of a particle field; empty if the field has no positions.
///
/// As in the schema, arrays that are too long are cut, and arrays that are too short are ignored.
pub(crate) fn cloud(package: &Package<'_>, entry: &SplatsEntry, task: Task<'_>) -> Result<Cloud, Fault> {
    let SplatsEntry { place, .. } = entry;
    let positions = entry.positions.as_ref().map_or(Ok(Vec::new()), |array| package.reals::<3>(array, place))?;
    let count = positions.len();
    // Limit the degree of the harmonics to the degree that is rendered.
    let in_file = usize::try_from(entry.degree).ok().filter(|degree| *degree <= 64);
    let in_file = in_file.ok_or_else(|| Fault::new(place, "a degree of harmonics from 0 to 64", entry.degree))?;
    let degree = in_file.min(MAX_DEGREE);
    if in_file > degree {
        let message = format!(
            "the harmonics have degree {in_file}, but degree {MAX_DEGREE} is the highest that is rendered; higher degrees are left out"
        );
        task.warn(place, message);
    }
    let orientations = rows::<4>(package, &entry.orientations, count, "orientations", place, task)?;
    let scales = rows::<3>(package, &entry.scales, count, "scales", place, task)?;
    let opacities = rows::<1>(package, &entry.opacities, count, "opacities", place, task)?;
    let [stride, kept] = [in_file, degree].map(|degree| (degree + 1).pow(2));
    let harmonics = rows::<3>(package, &entry.harmonics, count * stride, "harmonics", place, task)?;
    let (degree, harmonics) = match harmonics {
        Some(all) => (degree, all.chunks_exact(stride).flat_map(|own| own[..kept].as_flattened()).copied().collect()),
        // without harmonics the coefficients are 0, so the colour is ½ in every direction
        None => (0, vec![0.0; 3 * count]),
    };
    let flat = if entry.flat { Vec3::new(1.0, 1.0, 0.0) } else { Vec3::ONE };
    let scale = |scale: [f32; 3]| Vec3::from(scale) * flat;
    Ok(Cloud {
        place: place.clone(),
        positions: positions.into_iter().map(Vec3::from).collect(),
        rotations: orientations
            .map_or_else(|| vec![Quat::IDENTITY; count], |all| all.into_iter().map(Quat::from_array).collect()),
        scales: scales.map_or_else(|| vec![flat; count], |all| all.into_iter().map(scale).collect()),
        opacities: opacities.map_or_else(|| vec![1.0; count], |all| all.into_iter().map(|[value]| value).collect()),
        degree,
        harmonics,
        encoding: encoding(&entry.colour_space, place, task),
    })
}

/// Returns the first `count` rows of an array. `None` if the array is absent. Also `None`, after a
/// warning, if the array is too short.
fn rows<const N: usize>(
    package: &Package<'_>,
    array: &Option<Array>,
    count: usize,
    name: &str,
    place: &str,
    task: Task<'_>,
) -> Result<Option<Vec<[f32; N]>>, Fault> {
    let Some(array) = array else { return Ok(None) };
    let mut rows = package.reals::<N>(array, place)?;
    if rows.len() < count {
        task.warn(place, format!("expected {count} {name}, found {}; the {name} are left out", rows.len()));
        return Ok(None);
    }
    rows.truncate(count);
    Ok(Some(rows))
}

/// Returns the encoding of colours in the space `name`. Captures contain sRGB even if their files
/// do not declare it.
fn encoding(name: &str, place: &str, task: Task<'_>) -> Encoding {
    match name {
        "" | "auto" | "sRGB" | "srgb_texture" | "srgb_rec709_scene" | "srgb_rec709_display" => Encoding::Srgb,
        "linear" | "lin_rec709" | "lin_rec709_scene" | "lin_rec709_display" | "lin_srgb" => Encoding::Linear,
        other => {
            let taken = if other.starts_with("lin") { Encoding::Linear } else { Encoding::Srgb };
            let as_name = if taken == Encoding::Linear { "lin_rec709_scene" } else { "srgb_rec709_display" };
            task.warn(place, format!("the colour space {other} of the splats is unknown; {as_name} is used"));
            taken
        }
    }
}
