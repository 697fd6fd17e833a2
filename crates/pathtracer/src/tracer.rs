//! Radiance along the rays of a pixel: the path loop.
//!
//! ```text
//! L = Σ_k T_k [ w_b E(hit k) + w_l f |cos| L_l V / p_l ],   T_{k+1} = T_k f |cos| / p_b
//! w = p² / (p_b² + p_l²)
//! ```
//!
//! T is the throughput, f the scattering function, and E the emission of the hit surface. The
//! second term is one sampled light with the radiance L_l and the visibility V. The density of
//! scattered directions is p_b, the density of light sampling is p_l. The weights w_b and w_l
//! follow the power heuristic w. Its numerator is the squared density of the technique that made
//! the sample: p_b² for w_b, p_l² for w_l.
//!
//! For alpha of mode `Blend`, chance decides whether the surface is there for a camera ray or a
//! scattered ray. A shadow ray passes the surface, and its light is multiplied by the transparent
//! fraction. The mean is right in both cases.
//!
//! The samples of a pixel are traced together: first one vertex of every path, then the next vertex
//! of every path. Pixels with few samples are traced together with their neighbours. First rays are
//! close together and traverse the tree as a beam. At a vertex, all samples of a pixel share the
//! hash of each pair of random numbers. While one path waits for memory, the next is computed.
//!
//! Measured on FlightHelmet with 16 samples per pixel:
//!
//! * Tracing rays takes half of the time. The other half is spent on waiting for memory and on
//!   branches rather than on arithmetic. The whole program compiled for AVX2 with FMA was no
//!   faster.
//! * Nearly all variance of a diffuse scene comes from the first scattered direction. A trial had
//!   four jointly stratified points of lights at the first hit, instead of one. The squared error
//!   fell by 7 %, but the time rose by 80 %.
//! * Between rays, paths wait for chains of square roots and divisions. They also wait for values
//!   that are read in larger pieces than they were written in. So primary rays and directions
//!   around normals are computed for all paths together, as vectors. Hits are written where they
//!   are read, and a light's density is kept as its inverse. Together these changes gave 9 % more
//!   samples per second.
//! * With a separate loop over all paths for each step of a vertex (surface, light, scattered
//!   direction), the time rose by 3 %. The results of the steps then have to be stored.
//! * The shadow rays of first hits, traced as beams, took 1.6 times as long as single rays. These
//!   beams tested the bounds of every block with eight rays together.

use glam::Vec3;
use lumistack_scene::{Lamp, Material};

use crate::bsdf::{Appearance, Bsdf, Scatter, cosine_directions};
use crate::bvh::{ALPHA, BEAM, Bvh, Hit, Ray, Stack, TINT};
use crate::geometry::{Geometry, SurfacePoint};
use crate::lambert::{Lambert, is_lambertian};
use crate::light::{Lights, Receiver};
use crate::math::{all_ones, ones};
use crate::sampler::{Draws, Pair};
use crate::settings::Settings;
use crate::shading::Materials;
use crate::sparse::{SparsePaths, are_on_a_plane, is_one_surface};
use crate::surface::{First, Gloss, Guide};

/// Number of pairs of random numbers for a primary ray. The first pair chooses the position in the
/// pixel, the second pair the slope within the angular filter.
pub(crate) const PRIMARY_PAIRS: u64 = 2;
/// Number of pairs of random numbers per vertex of a path. The first pair chooses the scattered
/// direction, and the second chooses the point of a light. The third decides about roulette, and
/// about reflection or refraction.
const VERTEX_PAIRS: u64 = 3;
/// First of the pairs that decide whether a surface with alpha is there. There is one pair for each
/// bounce and triangle, so that successive surfaces decide independently.
const ALPHA_PAIRS: u64 = 1 << 62;
/// Odd factor on the index of an instance, so that different instances use different pairs of
/// random numbers.
const INSTANCE_STEP: u64 = 0x2545_f491_4f6c_dd1d;
/// The pair that chooses a wavelength.
const WAVE_PAIR: u64 = ALPHA_PAIRS - 1;
/// Largest chance of a path to survive roulette, so that paths in lossless scenes end too.
const MOST_SURVIVAL: f32 = 0.95;
/// Smallest spread of a ray's footprint after a scattering event at a lobe with α = 1, as a
/// fraction of the distance. For other lobes it is multiplied by α.
const SCATTER_SPREAD: f32 = 0.1;

/// Footprint of a ray: `width + spread · t`, in render space (Akenine-Möller et al. 2019, "Texture
/// level of detail strategies").
#[derive(Clone, Copy, Debug)]
pub(crate) struct Cone {
    pub(crate) width: f32,
    pub(crate) spread: f32,
}

impl Cone {
    fn width_at(self, t: f32) -> f32 {
        self.width + self.spread * t
    }
}

/// Marks a material that scatters by Lambert's law alone, see [`is_lambertian`].
const LAMBERTIAN: u8 = 1;
/// Marks a material that may emit light.
const EMISSIVE: u8 = 2;
/// Marks a material that shows its colour and scatters nothing.
const UNLIT: u8 = 4;
/// Marks the material of a light source that viewers do not see. First rays pass through it.
const UNSEEN: u8 = 8;

/// Returns the properties of a material that the path loop reads at every hit, in one byte.
pub(crate) fn traits(material: &Material) -> u8 {
    let flag = |is: bool, flag: u8| if is { flag } else { 0 };
    flag(is_lambertian(material), LAMBERTIAN)
        | flag(material.is_emissive(), EMISSIVE)
        | flag(material.unlit, UNLIT)
        | flag(material.lamp == Lamp::Unseen, UNSEEN)
}

/// The scene in which rays are traced.
#[derive(Clone, Copy)]
pub(crate) struct Tracer<'a> {
    pub(crate) geometry: &'a Geometry,
    pub(crate) bvh: &'a Bvh,
    pub(crate) materials: &'a Materials,
    pub(crate) lights: &'a Lights,
    /// Properties of every material: [`LAMBERTIAN`], [`EMISSIVE`], [`UNLIT`], [`UNSEEN`].
    pub(crate) traits: &'a [u8],
    /// Radiance that straight paths from the viewer see past the scene, instead of the environment.
    pub(crate) backdrop: Option<Vec3>,
}

/// The scattering function of a point.
#[expect(clippy::large_enum_variant, reason = "on the stack and never moved; a box would allocate at every hit")]
enum Surface {
    Lambert(Lambert),
    General(Bsdf),
}

/// The state of a path.
#[derive(Clone, Copy)]
struct Path {
    radiance: Vec3,
    throughput: Vec3,
    cone: Cone,
    /// The last vertex that changed the path's direction, as a receiver of light.
    scattered_at: Receiver,
    /// Density of the direction that was chosen at `scattered_at`; infinite for primary rays and
    /// after mirrors.
    scattered_pdf: f32,
    /// True if no event has changed the path's direction since the viewer.
    straight: bool,
    /// Material of the solid that the path is in.
    inside: Option<usize>,
    /// Wavelength of a path that has entered dispersing glass.
    wave_nm: Option<f32>,
    /// Fraction of the light of later vertices that the path's first surface scatters by Lambert's
    /// law. It is set only if the first surfaces are recorded.
    diffuse: Vec3,
}

/// Unshadowed contributions of sampled lights, for `count` paths.
struct Shadows {
    count: usize,
    rays: [Ray; BEAM],
    /// Index of the path, direction to the light, contribution.
    lights: [(usize, Vec3, Vec3); BEAM],
    /// Fraction of each contribution that the path's first surface scatters by Lambert's law. It is
    /// set only if the first surfaces are recorded.
    diffuse: [Vec3; BEAM],
}

/// A hit with the data by which it is shaded.
struct Vertex<'a> {
    point: SurfacePoint<'a>,
    material: usize,
    front: bool,
    /// Geometric normal on the side from which the ray came.
    normal: Vec3,
    width: f32,
}

impl Tracer<'_> {
    /// Computes the radiance along at most [`BEAM`] rays that are close together. Each ray has a
    /// cone. `draws` has the random numbers of all rays. If `in_bounds` is false, the rays hit
    /// nothing. The call overwrites `rays`. A ray whose bit is set in `paths_of_rays` continues as
    /// a path; the others end at their first surface. If `FIRST` is true, the first surface of
    /// every ray is written to `first`, which needs an element per ray. In this case, `sparse` may
    /// also end some of the paths at their first surfaces. For the paths that continue, the
    /// radiance is the same for both values of `FIRST`, bit for bit.
    pub(crate) fn radiance<const FIRST: bool>(
        &self,
        rays: &mut [Ray],
        mut paths_of_rays: u32,
        sparse: Option<SparsePaths>,
        cones: &[Cone],
        in_bounds: bool,
        settings: &Settings,
        draws: &Draws<'_>,
        stack: &mut Stack,
        first: &mut [First],
    ) -> [Vec3; BEAM] {
        let mut hits = [None; BEAM];
        self.first_hits(rays, in_bounds, draws, stack, &mut hits);
        hits.iter().flatten().for_each(|hit| self.geometry.prefetch(hit.triangle));
        if FIRST {
            let known = sparse.map_or(0, |sparse| {
                self.end_paths(sparse, rays, &hits, cones, settings, draws, &mut paths_of_rays, first)
            });
            for index in ones(!(known | paths_of_rays) & all_ones(rays.len())) {
                first[index] = self.seen(&rays[index], hits[index].as_ref(), cones[index], settings, draws);
            }
        }
        let start = Path {
            radiance: Vec3::ZERO,
            throughput: Vec3::ONE,
            cone: cones[0],
            scattered_at: Receiver { position: Vec3::ZERO, normal: None, tilt: Receiver::UPRIGHT },
            scattered_pdf: f32::INFINITY,
            straight: true,
            inside: None,
            wave_nm: None,
            diffuse: Vec3::ZERO,
        };
        let mut paths = [start; BEAM];
        paths.iter_mut().zip(cones).for_each(|(path, cone)| path.cone = *cone);
        // a vertex adds at most one shadow ray; shadow rays are traced after all paths have
        // scattered
        let mut shadows = Shadows {
            count: 0,
            rays: [rays[0]; BEAM],
            lights: [(0, Vec3::ZERO, Vec3::ZERO); BEAM],
            diffuse: [Vec3::ZERO; BEAM],
        };
        // each path that continues has its bit set
        let mut going = paths_of_rays;
        for bounce in 0..=settings.max_bounces {
            let pairs = PRIMARY_PAIRS + VERTEX_PAIRS * u64::from(bounce);
            let mut pairs = [draws.pair(pairs), draws.pair(pairs + 1), draws.pair(pairs + 2)];
            shadows.count = 0;
            let around_normal = self.cosine_directions(going, &mut pairs[0]);
            // scatter every path at its hit, or end it with the light from infinity
            for (place, index) in ones(going).enumerate() {
                let path = &mut paths[index];
                let before = path.radiance;
                let next = match &hits[index] {
                    Some(hit) => {
                        let around_normal = Vec3::from_array(around_normal.map(|row| row[place]));
                        self.scatter::<FIRST>(
                            path,
                            index,
                            &rays[index],
                            hit,
                            bounce,
                            settings,
                            &mut pairs,
                            around_normal,
                            draws,
                            &mut shadows,
                            first,
                        )
                    }
                    None if bounce == 0 && settings.hide_environment => None,
                    None => {
                        let (environment, light_pdf) = match self.backdrop {
                            Some(backdrop) if path.straight => (backdrop, 0.0),
                            _ => self.lights.infinite(rays[index].direction, draws.parts()),
                        };
                        path.radiance +=
                            path.throughput * environment * heuristic(ratio(light_pdf, path.scattered_pdf));
                        None
                    }
                };
                if FIRST && bounce == 0 {
                    (first[index].seen, first[index].is_path) = (path.radiance, true);
                }
                if FIRST && bounce > 0 {
                    // the light is multiplied by the fraction that the path's first surface
                    // scatters diffusely
                    first[index].diffuse += (path.radiance - before) * path.diffuse;
                }
                match next {
                    Some(ray) => rays[index] = ray,
                    None => going &= !(1 << index),
                }
            }
            // add the sampled lights, each times the fraction of its light that arrives
            for (place, (ray, (index, direction, light))) in
                shadows.rays.iter().zip(&shadows.lights).take(shadows.count).enumerate()
            {
                let passed = self.bvh.transmittance(ray, stack, |hit| self.passed(hit, *direction));
                paths[*index].radiance += *light * passed;
                if FIRST {
                    first[*index].diffuse += *light * passed * shadows.diffuse[place];
                }
            }
            // trace the next ray of every path that continues
            if going == 0 {
                break;
            }
            for index in ones(going) {
                let hit = &mut hits[index];
                self.bvh.find_nearest(&rays[index], stack, |hit| self.is_there(hit, bounce + 1, draws, index), hit);
                if let Some(hit) = hit {
                    self.geometry.prefetch(hit.triangle);
                }
            }
        }
        paths.map(|path| path.radiance)
    }

    /// Ends most paths of each group of rays that see one surface, at that surface. Removes the
    /// bits of these paths from `paths`. Returns the bits of the rays whose first surface is
    /// written to `first`.
    fn end_paths(
        &self,
        sparse: SparsePaths,
        rays: &[Ray],
        hits: &[Option<Hit>; BEAM],
        cones: &[Cone],
        settings: &Settings,
        draws: &Draws<'_>,
        paths: &mut u32,
        first: &mut [First],
    ) -> u32 {
        let mut known = 0;
        for group in sparse.groups(rays.len()) {
            // Most groups at edges are recognized by their points, before textures are read.
            let Some(hit) = &hits[group.start] else { continue };
            let width = cones[group.start].width_at(hit.t);
            let point = |hit: &Hit| {
                let point = self.geometry.hit_point(hit);
                (point.position, point.geometric_normal)
            };
            if !are_on_a_plane(hits[group.clone()].iter().map(|hit| hit.as_ref().map(point)), width) {
                continue;
            }
            for index in group.clone() {
                first[index] = self.seen(&rays[index], hits[index].as_ref(), cones[index], settings, draws);
                known |= 1 << index;
            }
            if is_one_surface(&first[group.clone()]) {
                *paths = sparse.fewer(*paths, group);
            }
        }
        known
    }

    /// Returns the first surface of every ray, as [`radiance`](Self::radiance) finds it. Its light
    /// and the reflectances of its lobes are not computed.
    pub(crate) fn first(
        &self,
        rays: &mut [Ray],
        cones: &[Cone],
        in_bounds: bool,
        draws: &Draws<'_>,
        stack: &mut Stack,
    ) -> [First; BEAM] {
        let mut hits = [None; BEAM];
        self.first_hits(rays, in_bounds, draws, stack, &mut hits);
        let mut first = [First::default(); BEAM];
        for (((first, hit), ray), cone) in first.iter_mut().zip(&hits).zip(rays).zip(cones) {
            if let Some(hit) = hit {
                let vertex = self.vertex(ray, *cone, hit);
                *first = vertex.first(Vec3::ZERO, self.guide(&vertex, -ray.direction));
            }
        }
        first
    }

    /// Returns the first surface of a ray that does not continue as a path, and the light that the
    /// ray itself sees.
    fn seen(&self, ray: &Ray, hit: Option<&Hit>, cone: Cone, settings: &Settings, draws: &Draws<'_>) -> First {
        let Some(hit) = hit else {
            let seen = match self.backdrop {
                _ if settings.hide_environment => Vec3::ZERO,
                Some(backdrop) => backdrop,
                None => self.lights.infinite(ray.direction, draws.parts()).0,
            };
            return First { seen, ..First::default() };
        };
        let vertex = self.vertex(ray, cone, hit);
        let traits = self.traits[vertex.material];
        let mut first = if settings.max_bounces == 0 || traits & UNLIT != 0 {
            vertex.first(Vec3::ZERO, self.guide(&vertex, -ray.direction))
        } else if traits & LAMBERTIAN != 0 {
            let lambert = self.lambert(&vertex);
            vertex.first(lambert.albedo(), Guide::of_lambert(&lambert))
        } else {
            let appearance = self.materials.appearance(vertex.material, &vertex.point, vertex.width);
            let bsdf = self.bsdf(&vertex, &appearance, -ray.direction);
            let first = vertex.first(bsdf.diffuse_reflectance(), Guide::new(&appearance, bsdf.normal()));
            First { gloss: Gloss::new(&appearance), ..first }
        };
        if traits & EMISSIVE != 0 {
            let cosine = vertex.normal.dot(ray.direction);
            first.seen = self.materials.emission(vertex.material, &vertex.point, vertex.width, vertex.front, cosine);
        }
        first
    }

    /// Traces rays as [`radiance`](Self::radiance) does, but only to their first hits. Returns the
    /// number of rays that miss all surfaces.
    pub(crate) fn misses(&self, rays: &mut [Ray], in_bounds: bool, draws: &Draws<'_>, stack: &mut Stack) -> usize {
        let mut hits = [None; BEAM];
        self.first_hits(rays, in_bounds, draws, stack, &mut hits);
        hits[..rays.len()].iter().filter(|hit| hit.is_none()).count()
    }

    /// Finds the first hits of rays that are close together.
    #[inline]
    fn first_hits(
        &self,
        rays: &mut [Ray],
        in_bounds: bool,
        draws: &Draws<'_>,
        stack: &mut Stack,
        hits: &mut [Option<Hit>; BEAM],
    ) {
        if in_bounds {
            self.bvh.nearest_of_beam(rays, hits, stack, |index, hit| self.is_there(hit, 0, draws, index));
        }
    }

    /// Returns a direction around the z axis for each path that continues, in the order of the
    /// paths. The z axis later becomes a normal. The directions are computed together, as vectors.
    ///
    /// Two versions of [`radiance`](Self::radiance) call this function and two more. Not inlined,
    /// the three functions made views of 16 samples 3 % slower.
    #[inline(always)]
    fn cosine_directions(&self, going: u32, pair: &mut Pair<'_>) -> [[f32; BEAM]; 3] {
        let mut u = [[0.0; BEAM]; 2];
        for (place, index) in ones(going).enumerate() {
            [u[0][place], u[1][place]] = pair.of(index);
        }
        cosine_directions(&u, going.count_ones() as usize)
    }

    /// Scatters a path at a vertex: adds the vertex's emission and one sampled light, and returns
    /// the next ray. `None` if the path ends.
    #[inline]
    fn scatter<const FIRST: bool>(
        &self,
        path: &mut Path,
        index: usize,
        ray: &Ray,
        hit: &Hit,
        bounce: u32,
        settings: &Settings,
        pairs: &mut [Pair<'_>; 3],
        around_normal: Vec3,
        draws: &Draws<'_>,
        shadows: &mut Shadows,
        first: &mut [First],
    ) -> Option<Ray> {
        let vertex = self.vertex(ray, path.cone, hit);
        // the solid that the path is in absorbs light up to the hit
        if let Some(material) = path.inside {
            path.throughput *= self.absorption(material, hit.t);
        }
        // add the emission, with its weight of the power heuristic, since light sampling at the
        // previous vertex can also find this light
        let cosine = vertex.normal.dot(ray.direction);
        let traits = self.traits[vertex.material];
        if traits & EMISSIVE != 0 {
            let emission = self.materials.emission(vertex.material, &vertex.point, vertex.width, vertex.front, cosine);
            // no other technique finds the light that a primary or a mirrored ray hits
            let light_pdf = if emission == Vec3::ZERO || path.scattered_pdf.is_infinite() {
                0.0
            } else {
                let distance = vertex.point.position.distance(path.scattered_at.position);
                self.lights.triangle_pdf(hit.triangle, &path.scattered_at, distance, cosine, draws.parts())
            };
            path.radiance += path.throughput * emission * heuristic(ratio(light_pdf, path.scattered_pdf));
        }
        let is_first = FIRST && bounce == 0;
        if bounce == settings.max_bounces || traits & UNLIT != 0 {
            if is_first {
                first[index] = vertex.first(Vec3::ZERO, self.guide(&vertex, -ray.direction));
            }
            return None;
        }
        // look up textures, and prepare the scattering function
        let mut vertex_nm = None;
        let surface = if traits & LAMBERTIAN != 0 {
            let lambert = self.lambert(&vertex);
            if is_first {
                first[index] = vertex.first(lambert.albedo(), Guide::of_lambert(&lambert));
            }
            Surface::Lambert(lambert)
        } else {
            let mut appearance = self.materials.appearance(vertex.material, &vertex.point, vertex.width);
            vertex_nm = appearance.disperse(path.wave_nm, || draws.numbers(WAVE_PAIR, index)[0]);
            let bsdf = self.bsdf(&vertex, &appearance, -ray.direction);
            if is_first {
                first[index] = vertex.first(bsdf.diffuse_reflectance(), Guide::new(&appearance, bsdf.normal()));
                first[index].gloss = Gloss::new(&appearance);
            }
            Surface::General(bsdf)
        };
        // next-event estimation: one sampled light, whose shadow ray is traced later
        let [u_roulette, u_fresnel] = pairs[2].of(index);
        if surface.is_smooth() && self.lights.can_be_sampled() {
            // `u_roulette` may be used twice: for the light's sample and for the roulette. The
            // light's sample is only added to the rest of the path, so the mean of the sum does not
            // change.
            self.direct(
                &vertex,
                &surface,
                pairs[1].of(index),
                u_roulette,
                draws.parts(),
                index,
                path.throughput,
                shadows,
                |value, direction| match (FIRST, is_first) {
                    (false, _) => Vec3::ZERO,
                    (_, true) => surface.diffuse_share(value, direction),
                    (_, false) => path.diffuse,
                },
            );
        }
        // sample the next direction
        let scatter = surface.sample(pairs[0].of(index), around_normal, u_fresnel)?;
        if is_first && scatter.pdf.is_finite() {
            path.diffuse = surface.diffuse_share(scatter.weight * scatter.pdf, scatter.direction);
        }
        path.throughput *= scatter.weight;
        // Russian roulette: a path survives with a chance in proportion to its throughput
        if bounce >= settings.roulette_start {
            let survival = path.throughput.max_element().min(MOST_SURVIVAL);
            // this also ends paths whose throughput is zero
            if u_roulette >= survival {
                return None;
            }
            path.throughput /= survival;
        }
        // update the state of the path for its next vertex
        if scatter.refracted {
            path.inside = if vertex.front { Some(vertex.material) } else { None };
            path.wave_nm = path.wave_nm.or(vertex_nm);
        }
        path.cone = Cone { width: vertex.width, spread: path.cone.spread.max(SCATTER_SPREAD * scatter.alpha) };
        let straight = scatter.crossed && scatter.pdf.is_infinite() && hit.flags & TINT != 0;
        if !straight {
            path.scattered_at = vertex.receiver(&surface, self.lights.has_horizon());
            path.scattered_pdf = scatter.pdf;
            path.straight = false;
        }
        Some(vertex.leave(scatter.direction))
    }

    /// Returns true if a ray hits a surface that viewers see.
    pub(crate) fn hits_surface(&self, ray: Ray, stack: &mut Stack) -> bool {
        self.first_surface(ray, stack).is_some()
    }

    /// Returns the distance along a ray, in render space, to the first surface that viewers see.
    /// Points at which the alpha leaves nothing of a surface are left out.
    pub(crate) fn first_surface(&self, ray: Ray, stack: &mut Stack) -> Option<f32> {
        let is_there = |hit: &Hit| hit.flags & ALPHA == 0 || (!self.is_unseen(hit) && self.coverage(hit) > 0.0);
        let hit = self.bvh.nearest(&ray, stack, is_there);
        hit.map(|hit| hit.t)
    }

    /// Returns the guide of a first surface whose scattering function is not needed.
    fn guide(&self, vertex: &Vertex<'_>, to_viewer: Vec3) -> Guide {
        if self.traits[vertex.material] & LAMBERTIAN != 0 {
            return Guide::of_lambert(&self.lambert(vertex));
        }
        let Vertex { material, point, front, normal, width } = vertex;
        let frame = self.materials.frame(*material, point, *width, *normal, *front, to_viewer);
        Guide::new(&self.materials.appearance(*material, point, *width), frame.shading)
    }

    fn vertex(&self, ray: &Ray, cone: Cone, hit: &Hit) -> Vertex<'_> {
        let point = self.geometry.hit_point(hit);
        let facing = point.geometric_normal.dot(ray.direction) < 0.0;
        let normal = if facing { point.geometric_normal } else { -point.geometric_normal };
        Vertex {
            material: self.geometry.material_index(hit.triangle),
            front: hit.front,
            normal,
            width: cone.width_at(hit.t),
            point,
        }
    }

    fn bsdf(&self, vertex: &Vertex<'_>, appearance: &Appearance, to_viewer: Vec3) -> Bsdf {
        let Vertex { material, point, front, normal, width } = vertex;
        let frame = self.materials.frame(*material, point, *width, *normal, *front, to_viewer);
        Bsdf::new(appearance, to_viewer, &frame, *front)
    }

    /// Replaces [`bsdf`](Self::bsdf) for a material that scatters by Lambert's law alone.
    #[inline(always)]
    fn lambert(&self, vertex: &Vertex<'_>) -> Lambert {
        let Vertex { material, point, front, normal, width } = vertex;
        let normals = self.materials.diffuse_normals(*material, point, *width, *normal, *front);
        Lambert::new(self.materials.base_color(*material, point, *width), *normal, normals)
    }

    /// Adds the contribution of one sampled light, whose shadow ray is still to be traced.
    #[inline]
    fn direct(
        &self,
        vertex: &Vertex<'_>,
        surface: &Surface,
        u: [f32; 2],
        u_fine: f32,
        parts: u32,
        index: usize,
        throughput: Vec3,
        shadows: &mut Shadows,
        diffuse: impl FnOnce(Vec3, Vec3) -> Vec3,
    ) {
        // draw a light and a point of it
        let receiver = vertex.receiver(surface, self.lights.has_horizon());
        let Some(light) = self.lights.sample(self.geometry, self.materials, &receiver, u, u_fine, parts) else {
            return;
        };
        // The light of punctual lights ends where the smooth surface turns away, not where its
        // triangles turn away. No other technique finds this light, so the weights of the power
        // heuristic stay right.
        let is_hard = light.inverse_pdf == 0.0 && vertex.may_bulge(surface);
        let (value, scatter_pdf) = if is_hard {
            surface.evaluate_above(vertex.smooth_normal(), light.direction)
        } else {
            surface.evaluate(light.direction)
        };
        let contribution = value * light.weight * heuristic(scatter_pdf * light.inverse_pdf);
        if contribution == Vec3::ZERO {
            return;
        }
        // keep the contribution until the shadow ray is traced
        let mut shadow = vertex.leave(light.direction);
        if is_hard && light.direction.dot(vertex.normal) <= 0.0 {
            shadow.origin = vertex.point.smooth_position(vertex.side()) + vertex.point.offset * vertex.normal;
        }
        if let Some(end) = light.end {
            shadow = Ray { direction: end - shadow.origin, t_max: 1.0, ..shadow };
        }
        shadows.rays[shadows.count] = shadow;
        shadows.lights[shadows.count] = (index, light.direction, throughput * contribution);
        shadows.diffuse[shadows.count] = diffuse(value, light.direction);
        shadows.count += 1;
    }

    /// Returns true if the hit surface is a lamp that viewers do not see.
    fn is_unseen(&self, hit: &Hit) -> bool {
        self.traits[self.geometry.material_index(hit.triangle)] & UNSEEN != 0
    }

    /// Decides whether a surface is there. A surface that is partly transparent by its alpha is
    /// there by chance. A lamp that viewers do not see is there for all hits except first hits.
    fn is_there(&self, hit: &Hit, bounce: u32, draws: &Draws<'_>, index: usize) -> bool {
        if hit.flags & ALPHA == 0 {
            return true;
        }
        if bounce == 0 && self.is_unseen(hit) {
            return false;
        }
        let coverage = self.coverage(hit);
        if coverage <= 0.0 || coverage >= 1.0 {
            return coverage > 0.0;
        }
        // `NO_INSTANCE` + 1 wraps to 0, so a hit without an instance is not moved to other pairs
        let instance = u64::from(hit.instance.wrapping_add(1)).wrapping_mul(INSTANCE_STEP);
        let pair = (u64::from(bounce) << 32) + u64::from(hit.triangle);
        draws.numbers((ALPHA_PAIRS + pair) ^ instance, index)[0] < coverage
    }

    fn coverage(&self, hit: &Hit) -> f32 {
        self.materials.coverage(self.geometry.material_index(hit.triangle), &self.geometry.hit_point(hit))
    }

    /// Returns the fraction of light that passes a surface with [`ALPHA`] or [`TINT`] without a
    /// change of direction.
    fn passed(&self, hit: &Hit, direction: Vec3) -> Vec3 {
        let coverage = if hit.flags & ALPHA == 0 { 1.0 } else { self.coverage(hit) };
        let open = Vec3::splat(1.0 - coverage);
        if coverage == 0.0 || hit.flags & TINT == 0 {
            return open;
        }
        let ray = Ray { origin: Vec3::ZERO, direction, t_max: hit.t };
        let vertex = self.vertex(&ray, Cone { width: 0.0, spread: 0.0 }, hit);
        let appearance = self.materials.appearance(vertex.material, &vertex.point, vertex.width);
        open + coverage * self.bsdf(&vertex, &appearance, -direction).straight()
    }

    /// Returns the fraction of light that is left after `distance` in a solid:
    /// attenuation_color^(distance / attenuation_distance).
    fn absorption(&self, material: usize, distance: f32) -> Vec3 {
        let (color, reference) = self.materials.attenuation(material);
        let exponent = distance / (reference * self.geometry.space.scale as f32);
        if exponent > 0.0 { color.powf(exponent) } else { Vec3::ONE }
    }
}

impl Surface {
    #[inline]
    fn is_smooth(&self) -> bool {
        match self {
            Self::Lambert(_) => true,
            Self::General(bsdf) => bsdf.is_smooth(),
        }
    }

    #[inline]
    fn evaluate(&self, direction: Vec3) -> (Vec3, f32) {
        match self {
            Self::Lambert(lambert) => lambert.evaluate(direction),
            Self::General(bsdf) => bsdf.evaluate(direction),
        }
    }

    fn evaluate_above(&self, horizon: Vec3, direction: Vec3) -> (Vec3, f32) {
        match self {
            Self::Lambert(lambert) => lambert.above(horizon).evaluate(direction),
            Self::General(bsdf) => bsdf.evaluate_above(horizon, direction),
        }
    }

    #[inline(always)]
    fn sample(&self, u: [f32; 2], around_normal: Vec3, u_fresnel: f32) -> Option<Scatter> {
        match self {
            Self::Lambert(lambert) => lambert.sample(around_normal),
            Self::General(bsdf) => bsdf.sample(u, u_fresnel),
        }
    }

    /// Returns the fraction of `value` that the diffuse lobe contributes, 0..1 per channel. `value`
    /// is f |cos|, summed over all lobes, for `direction`.
    fn diffuse_share(&self, value: Vec3, direction: Vec3) -> Vec3 {
        match self {
            Self::Lambert(_) => Vec3::ONE,
            Self::General(bsdf) => {
                let share = bsdf.evaluate_diffuse(direction) / value;
                // 0 where nothing is scattered
                Vec3::select(value.cmpgt(Vec3::ZERO), share.min(Vec3::ONE), Vec3::ZERO)
            }
        }
    }

    fn transmits(&self) -> bool {
        match self {
            Self::Lambert(_) => false,
            Self::General(bsdf) => bsdf.transmits(),
        }
    }
}

impl Vertex<'_> {
    /// Returns the data of the vertex as the first surface of a path.
    #[inline]
    fn first(&self, reflectance: Vec3, guide: Guide) -> First {
        let (position, normal) = (self.point.position, self.normal);
        First { is_there: true, reflectance, position, normal, guide, ..First::default() }
    }

    /// Returns this vertex as a [`Receiver`], which the choice of a light reads. If `horizon` is
    /// true and the triangle approximates a smooth opaque surface, lights below the triangle's
    /// plane are included too.
    #[inline(always)]
    fn receiver(&self, surface: &Surface, horizon: bool) -> Receiver {
        let tilt = if horizon && self.may_bulge(surface) {
            let cosine = self.normal.dot(self.smooth_normal()).clamp(0.0, 1.0);
            [cosine, (1.0 - cosine * cosine).sqrt()]
        } else {
            Receiver::UPRIGHT
        };
        Receiver { position: self.point.position, normal: (!surface.transmits()).then_some(self.normal), tilt }
    }

    /// Returns true if the triangle approximates a smooth opaque surface. Light may then arrive
    /// from below the triangle's plane.
    fn may_bulge(&self, surface: &Surface) -> bool {
        !self.point.is_flat() && !surface.transmits()
    }

    /// Returns 1 on the triangle's front, and −1 on its back.
    fn side(&self) -> f32 {
        self.normal.dot(self.point.geometric_normal).signum()
    }

    /// Returns the normal interpolated from the vertices, on the viewer's side.
    fn smooth_normal(&self) -> Vec3 {
        self.side() * self.point.shading_normal()
    }

    /// Returns a ray from this point, whose start is moved off the surface to the side of
    /// `direction`.
    fn leave(&self, direction: Vec3) -> Ray {
        let side = self.normal.dot(direction).signum();
        let origin = self.point.position + side * self.point.offset * self.normal;
        Ray { origin, direction, t_max: f32::INFINITY }
    }
}

/// Returns the weight of a sample by the power heuristic. `ratio` is the density with which the
/// other technique finds the sample, divided by the density of the technique that drew it.
#[inline]
fn heuristic(ratio: f32) -> f32 {
    1.0 / (1.0 + ratio * ratio)
}

/// Returns the density of the other technique divided by the density of the technique that drew the
/// sample. `own` is infinite if no other technique can find the sample.
#[inline]
fn ratio(other: f32, own: f32) -> f32 {
    if other == 0.0 { 0.0 } else { other / own }
}
