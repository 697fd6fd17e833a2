//! Parses MTL files, which define materials.
//!
//! A colour has one value or three. A map is a line with options and the name of a picture's file,
//! which may contain spaces. `-s` and `-o` scale and shift the texture coordinates: (u, v) ↦ s ·
//! (u, v) + o, where v points upwards. `-clamp on` repeats the picture's edge. Other options that
//! would change the appearance cause a warning. An invalid line causes a warning too; the rest of
//! the file is used.
//!
//! Source: Alias|Wavefront, *Object files*, version 4.2, appendix B1, "MTL material format".

use crate::text::joined;

/// One material. Values that are not in the file are `None`.
#[derive(Clone, Debug, Default, PartialEq)]
pub(crate) struct MtlMaterial {
    pub(crate) name: String,
    /// Diffuse colour, the key `Kd`, linear.
    pub(crate) diffuse: Option<[f32; 3]>,
    /// Emission, the key `Ke`, linear.
    pub(crate) emission: Option<[f32; 3]>,
    /// Opacity, the key `d`.
    pub(crate) alpha: Option<f32>,
    /// Exponent of the Phong highlight, the key `Ns`.
    pub(crate) shininess: Option<f32>,
    /// Roughness, the key `Pr`.
    pub(crate) roughness: Option<f32>,
    /// Metallic fraction, the key `Pm`.
    pub(crate) metallic: Option<f32>,
    /// Picture of the diffuse colour, the key `map_Kd`.
    pub(crate) diffuse_map: Option<Map>,
}

/// A picture, and the mapping of texture coordinates for it.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Map {
    pub(crate) file: String,
    pub(crate) scale: [f32; 2],
    pub(crate) offset: [f32; 2],
    pub(crate) clamp: bool,
}

/// Keys of maps that have no effect. Each key causes one warning per file.
const OTHER_MAPS: [&str; 17] = [
    "map_ka", "map_ks", "map_ke", "map_ns", "map_d", "map_tr", "map_bump", "bump", "map_pr", "map_pm", "map_ps",
    "norm", "disp", "decal", "refl", "map_refl", "map_disp",
];

/// Parses the materials of a file. `warn` receives a line number and a message.
pub(crate) fn parse(text: &str, warn: &mut dyn FnMut(usize, String)) -> Vec<MtlMaterial> {
    let mut materials: Vec<MtlMaterial> = Vec::new();
    let mut left_out: Vec<String> = Vec::new();
    for (number, line) in joined(text) {
        let line = line.trim();
        let (key, rest) = line.split_once(|c: char| c.is_whitespace()).unwrap_or((line, ""));
        let rest = rest.trim();
        // Keys belong to the material of the last line `newmtl`. Keys before the first such line
        // are ignored.
        if key == "newmtl" {
            materials.push(MtlMaterial { name: rest.to_owned(), ..MtlMaterial::default() });
            continue;
        }
        let Some(material) = materials.last_mut() else { continue };
        // Read the value of the key, or warn that it is invalid.
        let mut bad = |expected: &str| warn(number, format!("`{key}`: expected {expected}, found `{rest}`"));
        match key {
            "Kd" | "Ke" => match color(rest) {
                Some(color) if key == "Kd" => material.diffuse = Some(color),
                Some(color) => material.emission = Some(color),
                None => bad("one number or three"),
            },
            "d" | "Ns" | "Pr" | "Pm" => {
                let value = rest.strip_prefix("-halo").unwrap_or(rest).split_whitespace().next().and_then(finite);
                match key {
                    _ if value.is_none() => bad("a number"),
                    "d" => material.alpha = value,
                    "Ns" => material.shininess = value,
                    "Pr" => material.roughness = value,
                    _ => material.metallic = value,
                }
            }
            "map_Kd" | "map_kd" => {
                let mut unused = Vec::new();
                match map(rest, &mut |option| unused.push(option.to_owned())) {
                    Some(map) => material.diffuse_map = Some(map),
                    None => bad("the name of a picture"),
                }
                for option in unused {
                    warn(number, format!("`{key}`: the option {option} has no effect"));
                }
            }
            _ if OTHER_MAPS.contains(&key.to_ascii_lowercase().as_str())
                && !left_out.iter().any(|known| known == key) =>
            {
                warn(number, format!("`{key}` is not supported and has no effect"));
                left_out.push(key.to_owned());
            }
            _ => {}
        }
    }
    materials
}

/// Parses a colour: one value for all three channels, or three values. After the prefix `xyz` the
/// values are CIE XYZ, which is converted to linear sRGB.
fn color(text: &str) -> Option<[f32; 3]> {
    let (text, is_xyz) = match text.strip_prefix("xyz") {
        Some(rest) => (rest, true),
        None => (text, false),
    };
    let values: Option<Vec<f32>> = text.split('#').next().unwrap_or_default().split_whitespace().map(finite).collect();
    let [x, y, z] = match values?.as_slice() {
        [grey] => [*grey; 3],
        [r, g, b] => [*r, *g, *b],
        _ => return None,
    };
    if !is_xyz {
        return Some([x, y, z]);
    }
    // convert XYZ to linear sRGB (IEC 61966-2-1)
    Some([
        3.2406 * x - 1.5372 * y - 0.4986 * z,
        -0.9689 * x + 1.8758 * y + 0.0415 * z,
        0.0557 * x - 0.2040 * y + 1.0570 * z,
    ])
}

fn finite(text: &str) -> Option<f32> {
    text.parse().ok().filter(|value: &f32| value.is_finite())
}

/// Parses the value of a map's key: options, and then the name of a picture's file, which may
/// contain spaces. `unused` receives options that have no effect.
fn map(text: &str, unused: &mut dyn FnMut(&str)) -> Option<Map> {
    let mut map = Map { file: String::new(), scale: [1.0; 2], offset: [0.0; 2], clamp: false };
    let mut rest = text.trim();
    while let Some((option, after)) = option(rest) {
        // `most` is the largest number of the option's arguments, since some of them may be
        // omitted.
        let most = match option {
            "-blendu" | "-blendv" | "-bm" | "-boost" | "-cc" | "-clamp" | "-imfchan" | "-texres" | "-type" => 1,
            "-mm" => 2,
            _ => 3,
        };
        let counted = matches!(option, "-o" | "-s" | "-t");
        let (mut words, mut left) = (Vec::new(), after.trim_start());
        while words.len() < most && !left.is_empty() {
            let (word, after) = left.split_once(|c: char| c.is_whitespace()).unwrap_or((left, ""));
            if counted && finite(word).is_none() {
                break;
            }
            words.push(word);
            left = after.trim_start();
        }
        let pair = |default: f32| [0, 1].map(|i| words.get(i).and_then(|word| finite(word)).unwrap_or(default));
        match option {
            "-s" => map.scale = pair(1.0),
            "-o" => map.offset = pair(0.0),
            "-clamp" => map.clamp = words.first().is_some_and(|word| word.eq_ignore_ascii_case("on")),
            // These options only control the filtering of textures, so they need no warning.
            "-blendu" | "-blendv" | "-texres" => {}
            _ => unused(option),
        }
        rest = left;
    }
    map.file = rest.to_owned();
    (!rest.is_empty()).then_some(map)
}

/// Returns the option at the start of a text, and the text after the option.
fn option(text: &str) -> Option<(&str, &str)> {
    const OPTIONS: [&str; 13] = [
        "-blendu", "-blendv", "-bm", "-boost", "-cc", "-clamp", "-imfchan", "-mm", "-o", "-s", "-t", "-texres", "-type",
    ];
    let (word, rest) = text.split_once(|c: char| c.is_whitespace())?;
    let known = OPTIONS.into_iter().find(|known| word.eq_ignore_ascii_case(known))?;
    Some((known, rest))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn read(text: &str) -> (Vec<MtlMaterial>, Vec<String>) {
        let mut warnings = Vec::new();
        let materials = parse(text, &mut |line, message| warnings.push(format!("{line}: {message}")));
        (materials, warnings)
    }

    #[test]
    fn one_value_is_grey_and_options_stand_before_the_name() {
        let (materials, warnings) = read(
            "# note\nnewmtl a b\nKd 0.5\nKe 1 2 3 # glow\nd -halo 0.25\nmap_Kd -s 2 2 1 a.png\n\
             newmtl c\r\nKd xyz 0.9505 1 1.089\r\nmap_Kd -o 0.5 -clamp on -blendu off my picture.png\r\n",
        );
        assert_eq!(warnings, Vec::<String>::new());
        assert_eq!(
            (materials[0].name.as_str(), materials[0].diffuse, materials[0].alpha),
            ("a b", Some([0.5; 3]), Some(0.25))
        );
        assert_eq!(materials[0].emission, Some([1.0, 2.0, 3.0]));
        let map = |file: &str, scale, offset, clamp| Some(Map { file: file.into(), scale, offset, clamp });
        assert_eq!(materials[0].diffuse_map, map("a.png", [2.0, 2.0], [0.0, 0.0], false));
        assert_eq!(materials[1].diffuse_map, map("my picture.png", [1.0, 1.0], [0.5, 0.0], true));
        let white = materials[1].diffuse.unwrap();
        assert!(white.iter().all(|value| (value - 1.0).abs() < 1e-3), "the XYZ of sRGB's white gives {white:?}");
    }

    #[test]
    fn a_line_that_cannot_be_read_costs_no_other() {
        let (materials, warnings) = read(
            "Kd 1 1 1\nnewmtl a\nKd 1 2\nKd spectral a.rfl\nNs\nmap_Kd -s 2\nmap_Kd -bm 2 -mm 0 1 b.png\nmap_Bump c.png\nmap_Bump d.png\nPr 0.5\n",
        );
        assert_eq!((materials.len(), materials[0].diffuse, materials[0].roughness), (1, None, Some(0.5)));
        assert_eq!(materials[0].diffuse_map.as_ref().unwrap().file, "b.png");
        let expected = [
            "3: `Kd`: expected one number or three, found `1 2`",
            "4: `Kd`: expected one number or three, found `spectral a.rfl`",
            "5: `Ns`: expected a number, found ``",
            "6: `map_Kd`: expected the name of a picture, found `-s 2`",
            "7: `map_Kd`: the option -bm has no effect",
            "7: `map_Kd`: the option -mm has no effect",
            "8: `map_Bump` is not supported and has no effect",
        ];
        assert_eq!(warnings, expected);
    }
}
