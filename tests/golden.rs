//! Compares pictures of the renderer with the golden pictures, which the renderer made earlier.
//! There is a z-test for each pixel, for each block of pixels, and for the whole picture. So a
//! change of the random numbers passes, but a change of the mean fails.
//!
//! `golden.exr` in a case's folder is a view of the case's scene with many samples per pixel. It
//! has the linear mean μ of the samples, and the variance of this mean. A picture x of the same
//! scene has n samples per pixel. The distance of x from μ in standard errors,
//!
//! ```text
//! z = |x − μ| / √(σ²/n + var μ)        σ² = samples of the golden picture · var μ
//! ```
//!
//! must be within the bounds of chance, with Šidák's correction for the number of tests. The test
//! per pixel is the test of Mitsuba's own suite, which also permits some outliers. Sums over blocks
//! detect small differences that cover large areas.

use std::path::Path;

use exr::prelude::{FlatSamples, ReadChannels, ReadLayers, read};
use image::RgbImage;
use lumistack_core::colour::srgb_code;
use lumistack_field_io::picture::write_exr_channels;
use lumistack_testkit::statistics::z_limit;

use crate::common::{lumistack, root, succeed};

/// Cases that have their own scenes.
const CASES: [&str; 3] = ["glass", "letters", "still-life"];
/// Columns and rows of the pictures of all cases.
const SIZE: [usize; 2] = [84, 52];
/// Samples per pixel of a golden picture, and of a new picture that is compared with it.
const SAMPLES: [usize; 2] = [4096, 64];
/// Side of a block, pixels.
const BLOCK: usize = 4;
/// Probability that chance makes at least one test of a set fail. One set has the tests of all
/// pixels, and the other set the tests of the blocks and of the whole picture.
const FALSE_ALARM_RATE: f64 = 1e-2;
/// Fraction of the values, three per pixel, whose tests may fail in a correct picture. In caustics
/// the mean of 64 samples is not normally distributed, so some tests fail by chance.
const OUTLIERS: f64 = 0.0025;
/// Relative rounding error of golden pictures, whose values have 11 bits.
const ROUNDING: f64 = 1.0 / 2048.0;

const CHANNELS: [&str; 6] = ["B", "G", "R", "variance.B", "variance.G", "variance.R"];

/// Means of the samples, and the variances of these means, `[channel][pixel]`.
#[derive(Clone)]
struct Picture {
    mean: [Vec<f64>; 3],
    variance: [Vec<f64>; 3],
}

impl Picture {
    /// Renders the first view of a job's scene.
    fn render(job: &Path, samples: usize, seed: u64, folder: &Path) -> Self {
        let mut command = lumistack();
        command.arg("render").arg(job).arg("-o").arg(folder);
        command.args(["--linear", "--layers", "variance", "--only-views", "0,0", "--denoise", "off"]);
        command.args(["--resolution", &format!("{}x{}", SIZE[0], SIZE[1])]);
        succeed(command.args(["--samples", &samples.to_string(), "--seed", &seed.to_string()]));
        let [mean, variance] = ["view_00_00.exr", "layers_00_00.exr"].map(|name| channels(&folder.join(name)));
        let pick = |list: &[(String, Vec<f64>)], name: &str| {
            list.iter().find(|(known, _)| known == name).map(|(_, values)| values.clone()).unwrap()
        };
        Self {
            mean: [0, 1, 2].map(|c| pick(&mean, CHANNELS[c])),
            variance: [0, 1, 2].map(|c| pick(&variance, CHANNELS[3 + c])),
        }
    }

    fn read(path: &Path) -> Self {
        let mut list = channels(path).into_iter().map(|(_, values)| values);
        let mut three = || std::array::from_fn(|_| list.next().unwrap());
        Self { mean: three(), variance: three() }
    }

    /// Writes the picture with few bits per value. Further bits would be noise, which cannot be
    /// compressed.
    fn write(&self, path: &Path) {
        let rounded = |values: &Vec<f64>| -> Vec<f32> {
            values
                .iter()
                .map(|value| f32::from_bits((*value as f32).to_bits().wrapping_add(1 << 12) & !0x1fff))
                .collect()
        };
        let values: Vec<Vec<f32>> = self.mean.iter().chain(&self.variance).map(rounded).collect();
        let channels: Vec<(&str, &[f32])> = CHANNELS.into_iter().zip(values.iter().map(Vec::as_slice)).collect();
        write_exr_channels(path, SIZE, &channels).unwrap();
    }

    /// Compares the picture `other` with this golden picture, and returns the first failed test, or
    /// `None`. The golden picture has `samples[0]` samples per pixel, and `other` has `samples[1]`.
    fn problem(&self, other: &Self, samples: [usize; 2]) -> Option<String> {
        let [cols, rows] = SIZE;
        let share = samples[0] as f64 / samples[1] as f64;
        let difference = |c: usize, i: usize| other.mean[c][i] - self.mean[c][i];
        let variance = |c: usize, i: usize| self.variance[c][i] * (share + 1.0);
        let slack = |c: usize, i: usize| ROUNDING * self.mean[c][i].abs() + 1e-6;
        let z = |difference: f64, slack: f64, variance: f64| {
            let excess = (difference.abs() - slack).max(0.0);
            if excess == 0.0 { 0.0 } else { excess / variance.sqrt() }
        };
        let limit = |tests: usize| z_limit(1.0 - (1.0 - FALSE_ALARM_RATE).powf(1.0 / tests as f64));

        let pixels = 3 * cols * rows;
        let all = (0..3).flat_map(|c| (0..cols * rows).map(move |i| (c, i)));
        let failed = all.filter(|&(c, i)| {
            let z = z(difference(c, i), slack(c, i), variance(c, i));
            z.is_nan() || z > limit(pixels)
        });
        let failed = failed.count();
        if failed as f64 > OUTLIERS * pixels as f64 {
            return Some(format!(
                "{failed} of {pixels} values differ from the golden picture by more than noise explains; expected at most {:.1}",
                OUTLIERS * pixels as f64
            ));
        }
        let all: Vec<usize> = (0..cols * rows).collect();
        let block = |y: usize, x: usize| {
            (0..BLOCK * BLOCK).map(|k| (BLOCK * y + k / BLOCK) * cols + BLOCK * x + k % BLOCK).collect()
        };
        let blocks = (0..rows / BLOCK).flat_map(|y| (0..cols / BLOCK).map(move |x| (y, x)));
        let mut regions: Vec<(String, Vec<usize>)> =
            blocks.map(|(y, x)| (format!("block at row {}, column {}", BLOCK * y, BLOCK * x), block(y, x))).collect();
        regions.push(("whole picture".into(), all));
        let limit = limit(3 * regions.len());
        regions.iter().flat_map(|region| (0..3).map(move |c| (c, region))).find_map(|(c, (name, inside))| {
            let sum = |value: &dyn Fn(usize, usize) -> f64| inside.iter().map(|&i| value(c, i)).sum::<f64>();
            let z = z(sum(&difference), sum(&slack), sum(&variance));
            let channel = ["blue", "green", "red"][c];
            (z.is_nan() || z > limit)
                .then(|| format!("{name}: {channel} is {z:.1} standard errors off, limit {limit:.1}"))
        })
    }

    fn save_png(values: impl Fn(usize, usize) -> f64, path: &Path) {
        let [cols, rows] = SIZE.map(|side| side as u32);
        let texel =
            |x: u32, y: u32| image::Rgb([2, 1, 0].map(|c| srgb_code(values(c, (y * cols + x) as usize) as f32)));
        RgbImage::from_fn(cols, rows, texel).save(path).unwrap();
    }
}

/// Reads all channels of a file with their names, sorted by name as in the file.
fn channels(path: &Path) -> Vec<(String, Vec<f64>)> {
    let image = read().no_deep_data().largest_resolution_level().all_channels().first_valid_layer().all_attributes();
    let image = image.from_file(path).unwrap_or_else(|error| panic!("{}: {error}", path.display()));
    let of = |samples: &FlatSamples| samples.values_as_f32().map(f64::from).collect();
    let list = image.layer_data.channel_data.list.iter();
    list.map(|channel| (channel.name.to_string(), of(&channel.sample_data))).collect()
}

/// New pictures of every case agree with its golden picture. With LUMISTACK_WRITE=1 this test
/// renders the golden pictures again.
#[test]
fn renders_differ_from_golden_pictures_only_by_noise() {
    let renew = std::env::var_os("LUMISTACK_WRITE").is_some();
    let mut wrong = Vec::new();
    for name in CASES {
        let folder = tempfile::tempdir().unwrap();
        let case = root().join("tests/cases").join(name);
        let golden = case.join("golden.exr");
        if renew {
            Picture::render(&case.join("job.toml"), SAMPLES[0], 1, folder.path()).write(&golden);
        }
        let golden = Picture::read(&golden);
        let now = Picture::render(&case.join("job.toml"), SAMPLES[1], 2, &folder.path().join("now"));
        // check the tests themselves: they must detect a picture with 2 % more light
        let brighter = Picture { mean: now.mean.clone().map(|c| c.iter().map(|v| 1.02 * v).collect()), ..now.clone() };
        assert!(golden.problem(&brighter, SAMPLES).is_some(), "{name}: 2 % more light is not found");
        if let Some(problem) = golden.problem(&now, SAMPLES) {
            let left = root().join("target/golden").join(name);
            std::fs::create_dir_all(&left).unwrap();
            Picture::save_png(|c, i| now.mean[c][i], &left.join("picture.png"));
            Picture::save_png(|c, i| golden.mean[c][i], &left.join("reference.png"));
            // In the picture of the differences, grey of 0.2 stands for equal values. A difference
            // of one standard error adds 0.04.
            let error = |c: usize, i: usize| (golden.variance[c][i] * (SAMPLES[0] / SAMPLES[1] + 1) as f64).sqrt();
            let off = |c: usize, i: usize| 0.2 + 0.04 * (now.mean[c][i] - golden.mean[c][i]) / (error(c, i) + 1e-9);
            Picture::save_png(off, &left.join("difference.png"));
            wrong.push(format!("{name}: {problem}; see picture, reference and difference in {}", left.display()));
        }
    }
    let how = "if the change is intended, LUMISTACK_WRITE=1 cargo test -p lumistack-cli --test end_to_end golden:: renders them anew";
    assert!(wrong.is_empty(), "{}\n{how}", wrong.join("\n"));
}
