//! Particle fields in all versions of OpenUSD. Versions from 26.03 on know the schema; older
//! versions know only the attributes.

use glam::{Quat, Vec3};
use lumistack_core::{Cancel, Collector, Task};
use lumistack_scene::{Encoding, Scene};
use lumistack_usd::{LoadOptions, UsdError, load};

use crate::common;

/// Loads a layer. Returns its scene and its warnings.
fn loaded(text: &str) -> (Result<Scene, UsdError>, Vec<String>) {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("scene.usda");
    std::fs::write(&path, format!("#usda 1.0\n{text}\n")).unwrap();
    let (warnings, cancel) = (Collector::default(), Cancel::default());
    let scene = load(&path, &LoadOptions::default(), Task::quiet(&warnings, &cancel)).map(|loaded| loaded.scene);
    (scene, warnings.take().iter().map(ToString::to_string).collect())
}

#[test]
fn particle_fields_become_clouds_where_they_stand() {
    if common::python().is_none() {
        return;
    }
    let (scene, warnings) = loaded(
        r#"(
    upAxis = "Z"
)
def Xform "place" (
    prepend apiSchemas = ["ColorSpaceAPI"]
)
{
    uniform token colorSpace:name = "lin_rec709_scene"
    double3 xformOp:translate = (0, 0, 5)
    uniform token[] xformOpOrder = ["xformOp:translate"]
    def ParticleField3DGaussianSplat "splats"
    {
        double3 xformOp:scale = (2, 2, 2)
        uniform token[] xformOpOrder = ["xformOp:scale"]
        point3f[] positions = [(0, 0, 0), (1, 2, 3)]
        point3h[] positionsh = [(9, 9, 9)]
        quath[] orientationsh = [(1, 0, 0, 0), (0, 0, 1, 0)]
        float3[] scales = [(1, 2, 3), (0.5, 0.25, 0.125), (7, 7, 7)]
        half[] opacitiesh = [0.5, 0.25]
        uniform int radiance:sphericalHarmonicsDegree = 1
        float3[] radiance:sphericalHarmonicsCoefficients = [
            (1, 2, 3), (4, 5, 6), (7, 8, 9), (10, 11, 12), (-1, -2, -3), (-4, -5, -6), (-7, -8, -9), (-10, -11, -12)]
    }
}
def Xform "hidden"
{
    token visibility = "invisible"
    def ParticleField3DGaussianSplat "splats"
    {
        point3f[] positions = [(0, 0, 0)]
    }
}
def ParticleField3DGaussianSplat "guide"
{
    uniform token purpose = "guide"
    point3f[] positions = [(0, 0, 0)]
}"#,
    );
    let scene = scene.unwrap();
    assert!(warnings.is_empty(), "{warnings:?}");
    assert_eq!((scene.clouds.len(), scene.placed_clouds.len(), scene.instances.len()), (1, 1, 0));
    let cloud = &scene.clouds[0];
    assert_eq!(cloud.place, "/place/splats");
    assert_eq!(cloud.positions, [Vec3::ZERO, Vec3::new(1.0, 2.0, 3.0)]);
    assert_eq!(cloud.rotations, [Quat::IDENTITY, Quat::from_xyzw(0.0, 1.0, 0.0, 0.0)]);
    // arrays that are too long are cut
    assert_eq!(cloud.scales, [Vec3::new(1.0, 2.0, 3.0), Vec3::new(0.5, 0.25, 0.125)]);
    assert_eq!(cloud.opacities, [0.5, 0.25]);
    assert_eq!((cloud.degree, cloud.encoding), (1, Encoding::Linear));
    let expected: Vec<f32> = (1..=12).map(|i| i as f32).chain((1..=12).map(|i| -i as f32)).collect();
    assert_eq!(cloud.harmonics, expected);
    // (1, 2, 3) is scaled to (2, 4, 6), moved to (2, 4, 11), and z becomes y
    let at = scene.placed_clouds[0].scene_from_cloud.transform_point3(cloud.positions[1]);
    assert!(at.abs_diff_eq(Vec3::new(2.0, 11.0, -4.0), 1e-5), "{at}");
}

#[test]
fn what_a_field_lacks_is_as_the_schema_says() {
    if common::python().is_none() {
        return;
    }
    let (scene, warnings) = loaded(
        r#"
def ParticleField3DGaussianSplat "bare"
{
    point3f[] positions = [(0, 0, 0), (1, 0, 0)]
    float[] opacities = [0.5]
    float3[] radiance:sphericalHarmonicsCoefficients = [(1, 1, 1)]
}
def ParticleField "discs" (
    prepend apiSchemas = ["ParticleFieldPositionAttributeAPI", "ParticleFieldKernelGaussianSurfletAPI"]
)
{
    point3h[] positionsh = [(0, 0, 4)]
}
def ParticleField "blocks" (
    prepend apiSchemas = ["ParticleFieldPositionAttributeAPI", "ParticleFieldKernelConstantSurfletAPI"]
)
{
    point3f[] positions = [(0, 0, 0)]
}
def ParticleField3DGaussianSplat "empty"
{
}
def ParticleField3DGaussianSplat "wrong"
{
    point3f[] positions = [(0, 0, 0)]
    uniform int radiance:sphericalHarmonicsDegree = -2
}
def ParticleField3DGaussianSplat "high"
{
    point3f[] positions = [(0, 0, 9)]
    uniform int radiance:sphericalHarmonicsDegree = 4
    float3[] radiance:sphericalHarmonicsCoefficients = [
        (1, 1, 1), (1, 1, 1), (1, 1, 1), (1, 1, 1), (1, 1, 1), (1, 1, 1), (1, 1, 1), (1, 1, 1), (1, 1, 1), (1, 1, 1), (1, 1, 1), (1, 1, 1), (1, 1, 1),
        (1, 1, 1), (1, 1, 1), (1, 1, 1), (2, 2, 2), (2, 2, 2), (2, 2, 2), (2, 2, 2), (2, 2, 2), (2, 2, 2), (2, 2, 2), (2, 2, 2), (2, 2, 2)]
}"#,
    );
    let scene = scene.unwrap();
    let [bare, discs, high] = [0, 1, 2].map(|i| &scene.clouds[i]);
    assert_eq!((bare.opacities[1], bare.scales[1], bare.rotations[1]), (1.0, Vec3::ONE, Quat::IDENTITY));
    assert_eq!((bare.degree, &bare.harmonics[..], bare.encoding), (0, &[0.0; 6][..], Encoding::Srgb));
    assert_eq!((discs.positions[0], discs.scales[0]), (Vec3::new(0.0, 0.0, 4.0), Vec3::new(1.0, 1.0, 0.0)));
    assert_eq!((high.degree, &high.harmonics[..]), (3, &[1.0; 48][..]));
    assert_eq!(scene.placed_clouds.len(), 3);
    let expected = [
        "/bare: expected 2 opacities, found 1",
        "/bare: expected 32 harmonics, found 1",
        "/blocks: expected a particle field with a Gaussian kernel, found ParticleFieldKernelConstantSurfletAPI",
        "/wrong: expected a degree of harmonics from 0 to 64, found -2",
        "/high: the harmonics have degree 4, but degree 3 is the highest",
    ];
    for part in expected {
        assert!(warnings.iter().any(|warning| warning.contains(part)), "{part} {warnings:?}");
    }
    assert_eq!(warnings.len(), expected.len(), "{warnings:?}");
}

#[test]
fn instances_share_one_cloud() {
    if common::python().is_none() {
        return;
    }
    let (scene, warnings) = loaded(
        r#"
def PointInstancer "wood"
{
    rel prototypes = [</wood/tree>]
    int[] protoIndices = [0, 0, 0]
    point3f[] positions = [(0, 0, 0), (10, 0, 0), (20, 0, 0)]
    def Xform "tree"
    {
        double3 xformOp:translate = (0, 1, 0)
        uniform token[] xformOpOrder = ["xformOp:translate"]
        def ParticleField3DGaussianSplat "splats"
        {
            point3f[] positions = [(0, 0, 0)]
        }
    }
}
class Xform "bush"
{
    def ParticleField3DGaussianSplat "splats"
    {
        point3f[] positions = [(0, 0, 0)]
        float3[] scales = [(1, 1, 1)]
    }
}
def "one" (
    instanceable = true
    inherits = </bush>
)
{
}
def "two" (
    instanceable = true
    inherits = </bush>
)
{
}"#,
    );
    let scene = scene.unwrap();
    assert!(warnings.is_empty(), "{warnings:?}");
    assert_eq!((scene.clouds.len(), scene.placed_clouds.len()), (2, 5));
    let mut of_trees: Vec<Vec3> =
        scene.placed_clouds.iter().map(|placed| placed.scene_from_cloud.translation.into()).collect();
    of_trees.retain(|at| at.y == 1.0);
    assert_eq!(of_trees, [0.0, 10.0, 20.0].map(|x| Vec3::new(x, 1.0, 0.0)));
}
