//! Reads files of one cloud in every format, and files that are not valid.

use std::io::Cursor;
use std::io::Write as _;

use glam::{Quat, Vec3};
use lumistack_scene::Cloud;
use lumistack_splats::read::{Axes, Found, read, read_spz};
use lumistack_splats::write;

const NONE: &dyn Fn(&str) -> Result<Vec<u8>, String> = &|name| Err(format!("no file {name}"));

fn cloud(count: usize, degree: usize) -> Cloud {
    let mut state = 11u64;
    let mut next = || {
        state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (state >> 40) as f32 / (1 << 24) as f32
    };
    let mut cloud = Cloud { degree, ..Cloud::default() };
    for _ in 0..count {
        cloud.positions.push(Vec3::new(4.0 * next() - 2.0, 3.0 * next(), -5.0 * next()));
        cloud.rotations.push(Quat::from_xyzw(next() - 0.5, next() - 0.5, next() - 0.5, next() - 0.5).normalize());
        cloud.scales.push(Vec3::new(next() * 4.0 - 5.0, next() * 4.0 - 5.0, next() * 4.0 - 5.0).exp());
        cloud.opacities.push(0.02 + 0.96 * next());
        cloud.harmonics.extend((0..3 * (degree + 1).pow(2)).map(|_| 1.6 * next() - 0.8));
    }
    cloud
}

/// Returns the largest differences between two clouds: of positions, logarithms of scales,
/// directions of axes, opacities, constant harmonics and higher harmonics.
fn differences(a: &Cloud, b: &Cloud) -> [f32; 6] {
    assert_eq!((a.len(), a.degree), (b.len(), b.degree));
    let most = |values: &mut dyn Iterator<Item = f32>| values.fold(0.0, f32::max);
    let pairs = || 0..a.len();
    let values = 3 * a.coefficients();
    let of_harmonics = |constant: bool| {
        let each = a.harmonics.iter().zip(&b.harmonics).enumerate().filter(move |(i, _)| (i % values < 3) == constant);
        most(&mut each.map(|(_, (a, b))| (a - b).abs()))
    };
    [
        most(&mut pairs().map(|i| (a.positions[i] - b.positions[i]).abs().max_element())),
        most(&mut pairs().map(|i| (a.scales[i].ln() - b.scales[i].ln()).abs().max_element())),
        most(&mut pairs().map(|i| {
            let b = b.rotations[i].normalize();
            (a.rotations[i] * Vec3::X - b * Vec3::X).length().max((a.rotations[i] * Vec3::Z - b * Vec3::Z).length())
        })),
        most(&mut pairs().map(|i| (a.opacities[i] - b.opacities[i]).abs())),
        of_harmonics(true),
        of_harmonics(false),
    ]
}

fn assert_close(found: &Found, original: &Cloud, axes: Axes, most: [f32; 6]) {
    assert_eq!(found.axes, axes);
    let found = differences(original, &found.cloud);
    assert!(found.iter().zip(most).all(|(found, most)| *found <= most), "{found:?} {most:?}");
}

#[test]
fn trainers_ply_is_read_as_it_is() {
    for degree in 0..=3 {
        let original = cloud(300, degree);
        let found = read(&write::ply(&original), NONE).unwrap();
        assert_close(&found, &original, Axes::RightDownFront, [0.0, 1e-5, 1e-5, 1e-6, 0.0, 0.0]);
    }
}

#[test]
fn spz_of_every_version_is_read() {
    for degree in 0..=3 {
        let original = cloud(300, degree);
        let packed = write::spz(&original).unwrap();
        let found = read(&packed, NONE).unwrap();
        let most = [
            0.5 / 4096.0 + 1e-6,
            1.0 / 32.0 + 1e-5,
            5e-3,
            0.5 / 255.0 + 1e-6,
            0.5 / 255.0 / 0.15 + 1e-5,
            0.5 / 128.0 + 1e-6,
        ];
        assert_close(&found, &original, Axes::RightUpBack, most);
        // version 4 has the same data in separate streams
        let again = read(&version_4(&packed, original.len(), degree), NONE).unwrap();
        assert_eq!(again.cloud, found.cloud);
        // version 2 has rotations of three bytes, and version 1 also has positions as half floats
        let mut most = most;
        most[2] = 0.2;
        assert_close(&read(&older(&original, 2), NONE).unwrap(), &original, Axes::RightUpBack, most);
        most[0] = 4e-3;
        assert_close(&read(&older(&original, 1), NONE).unwrap(), &original, Axes::RightUpBack, most);
    }
}

/// Returns the decompressed data of an `.spz` file of version 3.
fn unpacked(packed: &[u8]) -> Vec<u8> {
    let mut bytes = Vec::new();
    std::io::Read::read_to_end(&mut flate2::read::GzDecoder::new(packed), &mut bytes).unwrap();
    bytes
}

fn gzip(bytes: &[u8]) -> Vec<u8> {
    let mut file = flate2::write::GzEncoder::new(Vec::new(), flate2::Compression::fast());
    file.write_all(bytes).unwrap();
    file.finish().unwrap()
}

/// Makes a Zstandard frame of uncompressed blocks.
fn zstd(bytes: &[u8]) -> Vec<u8> {
    let mut frame = vec![0x28, 0xb5, 0x2f, 0xfd, 0xe0];
    frame.extend((bytes.len() as u64).to_le_bytes());
    let blocks: Vec<&[u8]> = bytes.chunks(1 << 16).collect();
    for (i, block) in blocks.iter().enumerate() {
        let head = (block.len() as u32) << 3 | u32::from(i + 1 == blocks.len());
        frame.extend(&head.to_le_bytes()[..3]);
        frame.extend(*block);
    }
    frame
}

fn version_4(packed: &[u8], count: usize, degree: usize) -> Vec<u8> {
    let bytes = unpacked(packed);
    let mut rest = &bytes[16..];
    let strides = [9, 1, 3, 3, 4, 3 * ((degree + 1).pow(2) - 1)];
    let streams: Vec<(Vec<u8>, usize)> = strides
        .into_iter()
        .filter(|stride| *stride > 0)
        .map(|stride| {
            let (part, after) = rest.split_at(stride * count);
            rest = after;
            (zstd(part), part.len())
        })
        .collect();
    let mut file = b"NGSP".to_vec();
    file.extend(4u32.to_le_bytes());
    file.extend(&bytes[8..15]);
    file.push(streams.len() as u8);
    file.extend(32u32.to_le_bytes());
    file.extend([0; 12]);
    for (stream, length) in &streams {
        file.extend((stream.len() as u64).to_le_bytes());
        file.extend((*length as u64).to_le_bytes());
    }
    streams.iter().for_each(|(stream, _)| file.extend(stream));
    file
}

fn older(cloud: &Cloud, version: u32) -> Vec<u8> {
    let bytes = unpacked(&write::spz(cloud).unwrap());
    let count = cloud.len();
    let mut file = bytes[..16].to_vec();
    file[4..8].copy_from_slice(&version.to_le_bytes());
    if version == 1 {
        let halves = cloud.positions.iter().flat_map(|at| at.to_array()).map(lumistack_simd::nearest_half);
        file.extend(halves.flat_map(u16::to_le_bytes));
    } else {
        file.extend(&bytes[16..16 + 9 * count]);
    }
    let rotations = 16 + 16 * count;
    file.extend(&bytes[16 + 9 * count..rotations]);
    for rotation in &cloud.rotations {
        let positive = if rotation.w < 0.0 { -*rotation } else { *rotation };
        file.extend(positive.to_array()[..3].iter().map(|part| (127.5 * (part + 1.0)).round() as u8));
    }
    file.extend(&bytes[rotations + 4 * count..]);
    gzip(&file)
}

/// Makes a `.ply` file in PlayCanvas' compressed form.
fn packed_ply(cloud: &Cloud) -> Vec<u8> {
    let rest = 3 * (cloud.coefficients() - 1);
    let mut names = Vec::new();
    for end in ["min", "max"] {
        names.extend(["x", "y", "z"].map(|axis| format!("{end}_{axis}")));
    }
    for end in ["min", "max"] {
        names.extend(["x", "y", "z"].map(|axis| format!("{end}_scale_{axis}")));
    }
    let chunks = cloud.len().div_ceil(256);
    let mut file = format!("ply\nformat binary_little_endian 1.0\ncomment test\nelement chunk {chunks}\n").into_bytes();
    names.iter().for_each(|name| file.extend(format!("property float {name}\n").bytes()));
    file.extend(format!("element vertex {}\n", cloud.len()).bytes());
    for name in ["position", "rotation", "scale", "color"] {
        file.extend(format!("property uint packed_{name}\n").bytes());
    }
    if rest > 0 {
        file.extend(format!("element sh {}\n", cloud.len()).bytes());
        (0..rest).for_each(|i| file.extend(format!("property uchar f_rest_{i}\n").bytes()));
    }
    file.extend(b"end_header\n");
    let ends = |values: &[Vec3]| {
        values.iter().fold((Vec3::INFINITY, Vec3::NEG_INFINITY), |(low, high), v| (low.min(*v), high.max(*v)))
    };
    let logs: Vec<Vec3> = cloud.scales.iter().map(|scale| scale.ln()).collect();
    let mut of_chunks = Vec::new();
    for chunk in 0..chunks {
        let range = 256 * chunk..(256 * chunk + 256).min(cloud.len());
        let of_chunk = [ends(&cloud.positions[range.clone()]), ends(&logs[range])];
        for (low, high) in of_chunk {
            low.to_array().into_iter().chain(high.to_array()).for_each(|value| file.extend(value.to_le_bytes()));
        }
        of_chunks.push(of_chunk);
    }
    let bits = |value: f32, count: u32| (value * ((1 << count) - 1) as f32).round() as u32;
    for i in 0..cloud.len() {
        let three = |value: Vec3, (low, high): (Vec3, Vec3)| {
            let [x, y, z] = ((value - low) / (high - low)).to_array();
            bits(x, 11) << 21 | bits(y, 10) << 11 | bits(z, 11)
        };
        let [x, y, z, w] = cloud.rotations[i].to_array();
        let parts = [w, x, y, z];
        let largest = (0..4).fold(0, |best, k| if parts[k].abs() > parts[best].abs() { k } else { best });
        let mut rotation = largest as u32;
        for (_, part) in parts.iter().enumerate().filter(|(k, _)| *k != largest) {
            rotation = rotation << 10 | bits(part * parts[largest].signum() / std::f32::consts::SQRT_2 + 0.5, 10);
        }
        let harmonics = &cloud.harmonics[3 * cloud.coefficients() * i..];
        let [r, g, b] = [0, 1, 2].map(|c| bits((0.5 + 0.282_094_8 * harmonics[c]).clamp(0.0, 1.0), 8));
        let colour = r << 24 | g << 16 | b << 8 | bits(cloud.opacities[i], 8);
        let [of_positions, of_scales] = of_chunks[i / 256];
        let words = [three(cloud.positions[i], of_positions), rotation, three(logs[i], of_scales), colour];
        words.into_iter().for_each(|word| file.extend(word.to_le_bytes()));
    }
    for harmonics in cloud.harmonics.chunks_exact(3 * cloud.coefficients()) {
        for channel in 0..3 {
            let own = harmonics.iter().skip(3 + channel).step_by(3);
            file.extend(own.map(|value| ((value / 8.0 + 0.5) * 256.0 - 0.5).round() as u8));
        }
    }
    file
}

#[test]
fn playcanvas_compressed_ply_is_read() {
    for degree in [0, 2, 3] {
        let original = cloud(600, degree);
        let most = [
            0.5 * 5.0 / 1023.0 + 1e-4,
            0.5 * 4.0 / 1023.0 + 1e-4,
            5e-3,
            0.5 / 255.0 + 1e-6,
            0.5 / 255.0 / 0.28 + 1e-4,
            0.5 / 32.0 + 1e-4,
        ];
        assert_close(&read(&packed_ply(&original), NONE).unwrap(), &original, Axes::RightDownFront, most);
    }
}

#[test]
fn sog_is_read_from_a_folder_and_from_a_bundle() {
    for degree in [0, 1, 3] {
        let original = cloud(500, degree);
        let files = write::sog(&original).unwrap();
        let beside = |name: &str| {
            let found = files.iter().find(|(known, _)| known == name);
            found.map(|(_, bytes)| bytes.clone()).ok_or_else(|| "no such file".to_owned())
        };
        let found = read(&files[0].1, &beside).unwrap();
        let most = [4e-4, 0.5 * 4.0 / 255.0 + 1e-4, 2e-2, 0.5 / 255.0 + 1e-6, 0.8 / 255.0 + 1e-5, 0.8 / 255.0 + 1e-5];
        assert_close(&found, &original, Axes::RightDownFront, most);
        let mut bundle = zip::ZipWriter::new(Cursor::new(Vec::new()));
        for (name, bytes) in &files {
            bundle.start_file(name.as_str(), zip::write::SimpleFileOptions::default()).unwrap();
            bundle.write_all(bytes).unwrap();
        }
        assert_eq!(read(&bundle.finish().unwrap().into_inner(), NONE).unwrap(), found);
    }
}

#[test]
fn broken_files_are_refused_with_their_place() {
    let original = cloud(40, 1);
    let refused = |bytes: &[u8], part: &str| {
        let error = read(bytes, NONE).expect_err(part).to_string();
        assert!(error.contains(part), "{error:?} lacks {part:?}");
    };
    refused(b"", "a .ply, .spz or .sog file");
    refused(b"\x89PNG", "a .ply, .spz or .sog file");
    let ply = write::ply(&original);
    refused(&ply[..ply.len() - 1], "element vertex");
    refused(&ply[..60], "end_header");
    let text = String::from_utf8_lossy(&ply[..ply.len() - 4 * 26 * 40]).into_owned();
    let with = |from: &str, to: &str| [text.replace(from, to).as_bytes(), &ply[ply.len() - 4 * 26 * 40..]].concat();
    assert!(read(&with("comment", "comment"), NONE).is_ok());
    refused(&with("vertex 40", "vertex 41"), "expected 41 rows of 104 bytes");
    refused(&with("vertex 40", "vertex 99999999999999999999"), "a count of elements");
    refused(&with("vertex 40", "vertex 4000000000"), "rows of 104 bytes");
    refused(&with("binary_little_endian", "ascii"), "binary_little_endian");
    refused(&with("f_dc_0", "red"), "which this form of splat file requires (a mesh or a point cloud lacks it)");
    refused(&with("rot_3", "other"), "a property rot_3, which this form of splat file requires, found");
    refused(&with("f_rest_8", "other"), "f_rest_N");
    refused(&with("float x", "list uchar int x"), "no lists");
    let spz = write::spz(&original).unwrap();
    refused(&spz[..spz.len() / 2], "gzip stream");
    let bytes = unpacked(&spz);
    let changed = |at: usize, value: u8| {
        let mut bytes = bytes.clone();
        bytes[at] = value;
        gzip(&bytes)
    };
    refused(&changed(0, 0), "NGSP");
    refused(&changed(4, 9), "version");
    refused(&changed(12, 7), "shDegree");
    refused(&changed(13, 24), "fractionalBits");
    refused(&changed(11, 255), "numPoints");
    refused(&changed(10, 255), "gzip stream");
    assert!(read_spz(&spz, 100).unwrap_err().to_string().contains("numPoints"));
    let streams = version_4(&spz, 40, 1);
    let changed = |at: usize, value: u8| {
        let mut bytes = streams.clone();
        bytes[at] = value;
        bytes
    };
    refused(&streams[..streams.len() - 1], "stream 5");
    refused(&changed(15, 3), "numStreams");
    refused(&changed(19, 255), "tocByteOffset");
    refused(&changed(8, 41), "stream 0");
    refused(&changed(32 + 96, 0), "zstd");
    // the unchanged `.ply` file is valid, so its refusals above are due to the changes
    assert!(read(&with("end_header\n", "end_header\n"), NONE).is_ok());
}

/// Changes of single bytes, and cuts, cause no panic.
#[test]
fn no_change_of_a_byte_makes_a_reader_panic() {
    let original = cloud(20, 1);
    let spz = write::spz(&original).unwrap();
    let files = [write::ply(&original), packed_ply(&original), version_4(&spz, 20, 1), unpacked(&spz)];
    for (number, file) in files.iter().enumerate() {
        for at in (0..file.len()).step_by(1 + number) {
            for value in [0, 255, file[at] ^ 1, file[at] ^ 0x80] {
                let mut changed = file.clone();
                changed[at] = value;
                let changed = if number == 3 { gzip(&changed) } else { changed };
                drop(read(&changed, NONE));
            }
        }
        (0..file.len()).step_by(7).for_each(|end| drop(read(&file[..end], NONE)));
    }
}
