//! Material extensions: each test writes a small file and checks the scene.

use crate::support::{self, Builder, load, load_choosing, png, scene};
use glam::{Affine2, Vec2, Vec3, Vec4};
use lumistack_gltf::LoadOptions;
use lumistack_scene::{Anisotropy, Clearcoat, Iridescence, Material, Pixels, Sheen, TextureUse};
use serde_json::{Value, json};

/// Returns a triangle with a material, 15 textures of one picture, and coordinate sets 0, 1 and 4.
fn triangle_with(material: Value) -> Builder {
    let mut b = Builder::triangle();
    let uvs = b.floats("VEC2", &[0.0, 0.0, 1.0, 0.0, 0.0, 1.0]);
    for set in ["TEXCOORD_0", "TEXCOORD_1", "TEXCOORD_4"] {
        b.set(&format!("/meshes/0/primitives/0/attributes/{set}"), json!(uvs));
    }
    let picture = b.view(&png(2, &[[10, 20, 30, 0], [50, 60, 70, 255], [1, 2, 3, 102], [5, 6, 7, 51]]));
    b.push("images", json!({"bufferView": picture, "mimeType": "image/png"}));
    (0..15).for_each(|_| _ = b.push("textures", json!({"source": 0})));
    b.push("materials", material);
    b.set("/meshes/0/primitives/0/material", json!(0));
    b
}

/// Returns the JSON of a texture reference with its own transform, and the use of the texture that
/// the scene must have.
fn texture(number: usize) -> (Value, Option<TextureUse>) {
    let shift = 0.0625 * number as f32;
    let json = json!({"index": number, "texCoord": number % 2,
        "extensions": {"KHR_texture_transform": {"offset": [shift, 0.5]}}});
    let texture_from_mesh = Affine2::from_translation(Vec2::new(shift, 0.5));
    (json, Some(TextureUse { texture: 0, uv_set: number % 2, texture_from_mesh }))
}

/// Sets the texture's index to 0 in a use of a texture, since the index depends on the order in
/// which textures are read.
fn moved(found: Option<TextureUse>) -> Option<TextureUse> {
    found.map(|found| TextureUse { texture: 0, ..found })
}

#[test]
fn every_layer_keeps_its_factors_and_textures() {
    let (json, uses): (Vec<Value>, Vec<Option<TextureUse>>) = (0..11).map(texture).unzip();
    let mut coat_normal = json[4].clone();
    coat_normal["scale"] = json!(0.5);
    let b = triangle_with(json!({"extensions": {
        "KHR_materials_specular": {"specularFactor": 0.25, "specularTexture": json[0],
            "specularColorFactor": [0.5, 1.0, 2.0], "specularColorTexture": json[1]},
        "KHR_materials_dispersion": {"dispersion": 0.75},
        "KHR_materials_clearcoat": {"clearcoatFactor": 0.5, "clearcoatTexture": json[2],
            "clearcoatRoughnessFactor": 0.125, "clearcoatRoughnessTexture": json[3], "clearcoatNormalTexture": coat_normal},
        "KHR_materials_sheen": {"sheenColorFactor": [0.25, 0.5, 1.0], "sheenColorTexture": json[5],
            "sheenRoughnessFactor": 0.75, "sheenRoughnessTexture": json[6]},
        "KHR_materials_iridescence": {"iridescenceFactor": 1.0, "iridescenceTexture": json[7], "iridescenceIor": 1.5,
            "iridescenceThicknessMinimum": 200.0, "iridescenceThicknessMaximum": 500.0,
            "iridescenceThicknessTexture": json[8]},
        "KHR_materials_anisotropy": {"anisotropyStrength": 0.5, "anisotropyRotation": 1.5, "anisotropyTexture": json[9]},
    }}));
    let scene = scene(&b);
    let material = &scene.materials[0];
    assert_eq!((material.specular, material.dispersion, material.ior), (0.25, 0.75, 1.5));
    assert_eq!(material.specular_color, Vec3::new(0.5, 1.0, 2.0));
    let coat = material.clearcoat.unwrap();
    assert_eq!((coat.factor, coat.roughness, coat.normal_scale), (0.5, 0.125, 0.5));
    let sheen = material.sheen.unwrap();
    assert_eq!((sheen.color, sheen.roughness), (Vec3::new(0.25, 0.5, 1.0), 0.75));
    let film = material.iridescence.unwrap();
    assert_eq!((film.factor, film.ior, film.thickness_nm), (1.0, 1.5, [200.0, 500.0]));
    let stretch = material.anisotropy.unwrap();
    assert_eq!((stretch.strength, stretch.rotation_rad), (0.5, 1.5));
    let found = [
        material.specular_texture,
        material.specular_color_texture,
        coat.texture,
        coat.roughness_texture,
        coat.normal_texture,
        sheen.color_texture,
        sheen.roughness_texture,
        film.texture,
        film.thickness_texture,
        stretch.texture,
    ];
    for (number, texture) in found.into_iter().enumerate() {
        assert_eq!(moved(texture), uses[number], "texture {number}");
    }
    assert_eq!((material.textures().count(), scene.images.len()), (10, 1));
}

#[test]
fn layers_have_the_defaults_of_their_extensions() {
    let b = triangle_with(json!({"extensions": {"KHR_materials_specular": {}, "KHR_materials_dispersion": {},
        "KHR_materials_clearcoat": {}, "KHR_materials_sheen": {}, "KHR_materials_iridescence": {},
        "KHR_materials_anisotropy": {}}}));
    let film =
        Iridescence { factor: 0.0, texture: None, ior: 1.3, thickness_nm: [100.0, 400.0], thickness_texture: None };
    let expected = Material {
        clearcoat: Some(Clearcoat { normal_scale: 1.0, ..Clearcoat::default() }),
        sheen: Some(Sheen::default()),
        iridescence: Some(film),
        anisotropy: Some(Anisotropy::default()),
        ..Material::default()
    };
    assert_eq!(scene(&b).materials[0], expected);
}

#[test]
fn layers_use_any_two_sets_of_coordinates() {
    let b = triangle_with(json!({"extensions": {
        "KHR_materials_clearcoat": {"clearcoatTexture": {"index": 0, "texCoord": 4}},
        "KHR_materials_sheen": {"sheenColorTexture": {"index": 0, "texCoord": 1}}}}));
    let scene = scene(&b);
    let material = &scene.materials[0];
    // sets 1 and 4 of the file become sets 0 and 1 of the mesh
    assert_eq!(material.clearcoat.unwrap().texture.unwrap().uv_set, 1);
    assert_eq!(material.sheen.unwrap().color_texture.unwrap().uv_set, 0);
}

#[test]
fn glossiness_becomes_roughness() {
    let extension = json!({"KHR_materials_pbrSpecularGlossiness": {"diffuseFactor": [0.1, 0.2, 0.3, 0.4],
        "diffuseTexture": texture(0).0, "specularFactor": [0.5, 0.25, 0.125], "glossinessFactor": 0.5,
        "specularGlossinessTexture": texture(1).0}});
    let mut b = triangle_with(json!({"extensions": extension, "alphaMode": "BLEND",
        "pbrMetallicRoughness": {"metallicFactor": 1.0, "roughnessFactor": 0.9, "metallicRoughnessTexture": {"index": 5}}}));
    b.set("/extensionsRequired", json!(["KHR_materials_pbrSpecularGlossiness"]));
    let found = scene(&b);
    let material = &found.materials[0];
    assert_eq!(material.base_color, Vec4::new(0.1, 0.2, 0.3, 0.4));
    assert_eq!((material.metallic, material.roughness, material.ior, material.specular), (0.0, 1.0, 0.0, 1.0));
    assert_eq!(material.specular_color, Vec3::new(0.5, 0.25, 0.125));
    assert_eq!(moved(material.base_color_texture), texture(0).1);
    assert_eq!(moved(material.specular_color_texture), texture(1).1);
    let rough = material.metallic_roughness_texture.unwrap();
    assert_eq!(moved(Some(rough)), texture(1).1);
    // roughness is 1 − glossinessFactor · alpha, with the factor 0.5 and alpha 0, 1, 0.4 and 0.2
    let Pixels::Rgba8(texels) = &found.images[found.textures[rough.texture].image].pixels else { panic!() };
    let green: Vec<u8> = texels.iter().map(|texel| texel[1]).collect();
    assert_eq!(green, [255, 128, 204, 230]);
    // without a texture, the factor alone gives the roughness
    b.remove("/materials/0/extensions/KHR_materials_pbrSpecularGlossiness/specularGlossinessTexture");
    let material = scene(&b).materials[0].clone();
    assert_eq!((material.roughness, material.metallic_roughness_texture), (0.5, None));
    b.set("/materials/0/extensions/KHR_materials_pbrSpecularGlossiness", json!({}));
    let material = scene(&b).materials[0].clone();
    assert_eq!((material.roughness, material.specular_color, material.base_color), (0.0, Vec3::ONE, Vec4::ONE));
}

#[test]
fn broken_layers_are_named() {
    for (extension, place, expected) in [
        (json!({"KHR_materials_clearcoat": 5}), "KHR_materials_clearcoat", "an object, found 5"),
        (json!({"KHR_materials_sheen": {"sheenColorFactor": [1, 2]}}), "sheenColorFactor", "3 numbers, found [1,2]"),
        (
            json!({"KHR_materials_sheen": {"sheenColorTexture": {}}}),
            "sheenColorTexture/index",
            "an index, found nothing",
        ),
        (
            json!({"KHR_materials_clearcoat": {"clearcoatTexture": {"index": 99}}}),
            "clearcoatTexture/index",
            "an index below 15",
        ),
        (
            json!({"KHR_materials_pbrSpecularGlossiness": {"glossinessFactor": 2}}),
            "glossinessFactor",
            "a number in 0..1",
        ),
    ] {
        let message = support::error(&triangle_with(json!({"extensions": extension})));
        assert!(message.contains(&format!("{place}: expected {expected}")), "{message}");
    }
}

#[test]
fn variants_choose_materials() {
    let mut b = triangle_with(json!({"name": "plain"}));
    b.push("materials", json!({"name": "red"}));
    b.push("materials", json!({"name": "blue", "emissiveTexture": {"index": 77}}));
    let variants = json!([{"name": "Ruby"}, {"name": "Sapphire"}, {"name": "Bare"}]);
    b.set("/extensions", json!({"KHR_materials_variants": {"variants": variants}}));
    let mappings = json!([{"material": 1, "variants": [0]}, {"material": 2, "variants": [1]}]);
    b.set("/meshes/0/primitives/0/extensions", json!({"KHR_materials_variants": {"mappings": mappings}}));
    b.set("/extensionsRequired", json!(["KHR_materials_variants"]));
    let choose = |variant: Option<&str>| {
        let options = LoadOptions { variant: variant.map(Into::into), ..LoadOptions::default() };
        load_choosing(&b.glb(), &options).0.map(|scene| scene.materials[scene.meshes[0].material].name.clone())
    };
    // materials that no mesh uses are not read, so the broken texture of the third is no error
    assert_eq!(choose(None).unwrap(), "plain");
    assert_eq!(choose(Some("Ruby")).unwrap(), "red");
    assert_eq!(choose(Some("0")).unwrap(), "red");
    assert_eq!(choose(Some("Bare")).unwrap(), "plain");
    assert!(choose(Some("Sapphire")).unwrap_err().to_string().contains("/emissiveTexture/index"));
    assert_eq!(
        choose(Some("Topaz")).unwrap_err().to_string(),
        "test.gltf: expected the name or number of a material variant (0 (Ruby), 1 (Sapphire), 2 (Bare)), found Topaz"
    );
    let options = LoadOptions { variant: Some("Ruby".into()), ..LoadOptions::default() };
    let message = load_choosing(&Builder::triangle().glb(), &options).0.unwrap_err().to_string();
    assert!(message.contains("a material variant (there are none), found Ruby"), "{message}");
    b.set("/meshes/0/primitives/0/extensions/KHR_materials_variants/mappings/0/material", json!(9));
    assert!(load(&b.glb()).0.is_ok());
    let message = load_choosing(&b.glb(), &options).0.unwrap_err().to_string();
    assert!(message.contains("/mappings/0/material: expected an index below 3"), "{message}");
}

/// Pictures with one to four channels become pictures with four, texel by texel.
#[test]
fn pictures_of_any_channels_become_rgba() {
    let (width, height) = (5u32, 3u32);
    let value = |i: usize| (37 * i + 11) as u8;
    for channels in 1..=4usize {
        let raw: Vec<u8> = (0..channels * (width * height) as usize).map(value).collect();
        let kind = [
            image::ExtendedColorType::L8,
            image::ExtendedColorType::La8,
            image::ExtendedColorType::Rgb8,
            image::ExtendedColorType::Rgba8,
        ][channels - 1];
        let mut bytes = Vec::new();
        let encoder = image::codecs::png::PngEncoder::new(&mut bytes);
        image::ImageEncoder::write_image(encoder, &raw, width, height, kind).unwrap();
        let mut b = triangle_with(json!({"pbrMetallicRoughness": {"baseColorTexture": {"index": 0}}}));
        let picture = b.view(&bytes);
        b.json["images"] = json!([{"bufferView": picture, "mimeType": "image/png"}]);
        b.json["textures"] = json!([{"source": 0}]);
        let scene = scene(&b);
        let Pixels::Rgba8(texels) = &scene.images[0].pixels else { panic!() };
        let expected: Vec<[u8; 4]> = raw
            .chunks(channels)
            .map(|p| match *p {
                [grey] => [grey, grey, grey, 255],
                [grey, alpha] => [grey, grey, grey, alpha],
                [r, g, b] => [r, g, b, 255],
                _ => [p[0], p[1], p[2], p[3]],
            })
            .collect();
        assert_eq!(*texels, expected, "{channels} channels");
    }
}
