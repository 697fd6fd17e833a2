//! Parts of a capture.

use glam::Vec3;

/// What is kept; everything where neither is given.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(crate) struct Crop {
    /// Smallest and largest corner.
    corners: Option<[Vec3; 2]>,
    /// Centre and radius.
    sphere: Option<(Vec3, f32)>,
}

impl Crop {
    /// From `x0,y0,z0,x1,y1,z1` and `x,y,z,r`; empty texts are none.
    pub(crate) fn parse(corners: &str, sphere: &str) -> Result<Self, String> {
        let corners = numbers::<6>("crop_box", "x0,y0,z0,x1,y1,z1", corners)?.map(|[x0, y0, z0, x1, y1, z1]| {
            let (a, b) = (Vec3::new(x0, y0, z0), Vec3::new(x1, y1, z1));
            [a.min(b), a.max(b)]
        });
        let sphere = numbers::<4>("crop_sphere", "x,y,z,r", sphere)?.map(|[x, y, z, r]| (Vec3::new(x, y, z), r));
        Ok(Self { corners, sphere })
    }

    /// Drops the splats of a cloud whose centres, as they stand in the scene, lie outside.
    pub(crate) fn apply(self, cloud: &mut lumistack_splats::Cloud, place: impl Fn(Vec3) -> Vec3) {
        if self == Self::default() {
            return;
        }
        cloud.retain(|at| {
            let at = place(at);
            self.corners.is_none_or(|[low, high]| at.cmpge(low).all() && at.cmple(high).all())
                && self.sphere.is_none_or(|(centre, radius)| at.distance(centre) <= radius)
        });
    }
}

fn numbers<const N: usize>(name: &str, form: &str, text: &str) -> Result<Option<[f32; N]>, String> {
    if text.trim().is_empty() {
        return Ok(None);
    }
    let values: Option<Vec<f32>> = text.split(',').map(|value| value.trim().parse().ok()).collect();
    let values = values.filter(|values| values.iter().all(|value| value.is_finite()));
    let values: Option<[f32; N]> = values.and_then(|values| values.try_into().ok());
    values.map(Some).ok_or_else(|| format!("{name}: expected {form}, found {text}"))
}
