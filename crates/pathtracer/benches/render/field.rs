//! Compares four ways to render light fields. Views are rendered one by one, with light that the
//! views share, with shared light and further paths, or with a filter. Each way renders twice, with
//! independent seeds.

use std::time::Duration;

use lumistack_core::{Cancel, Collector, Task, Tensor};
use lumistack_display::{FieldGeometry, Projection, ViewGrid};
use lumistack_pathtracer::denoise::{NoisyView, SharedLight, Window, denoise};
use lumistack_pathtracer::{RenderError, Renderer, Settings};

use crate::case::{Case, Outcome};
use crate::peer::Peer;
use crate::{BOUNCES, Options};

/// Fraction of the values that are at most white. Errors are fractions of white.
const BELOW_WHITE: f64 = 0.99;
/// Number of samples per pixel of the view from which white is computed.
const OF_WHITE: u32 = 16;
/// Largest value of a path, as a multiple of white. Without peers, all ways dim brighter paths to
/// this value, since a few of them would hide all other errors. Pictures are not cut to white,
/// since this would darken pictures with more noise.
const CLAMP: f32 = 8.0;
/// Unit of the times in `/proc/self/stat`, in milliseconds.
const TICK_MS: u64 = 10;
/// Numbers of samples per pixel of views with shared light, and of filtered views.
const FILTERED: [u32; 3] = [4, 16, 64];
/// Numbers of samples per pixel of views rendered one by one. Views with the last number are the
/// reference, which takes longer to render than the views of any other way.
const ALONE: [u32; 4] = [4, 16, 64, 256];

/// A way to render the views of a light field.
#[derive(Clone, Copy, PartialEq)]
enum Kind {
    Alone,
    Shared,
    /// Shared, with [further paths](Settings::further_paths).
    Further,
    Guided,
}

/// One way to render a light field, with its results.
struct Way {
    kind: Kind,
    samples: u32,
    /// Processor time in seconds, the mean of both renders.
    seconds: f64,
    /// The views of two renders with independent seeds.
    pictures: [Vec<Tensor<3>>; 2],
}

/// Errors of the pictures that one way of rendering makes, over all views.
struct Errors {
    /// Mean squared error over all views, bias included.
    all: f64,
    /// Mean squared error of the worst view, bias included.
    worst: f64,
    /// Part of the squared error that is not noise; it remains at any number of samples.
    bias: f64,
    /// Mean of the pictures divided by the mean of the truth, minus 1.
    change: f64,
    /// Variance of the mean picture. All views are averaged pixel by pixel, and are not aligned by
    /// their parallax. The solver averages views in about this way, so a display shows about this
    /// noise.
    of_mean: f64,
}

/// The scene and the views of a bench.
struct Bench {
    case: Case,
    geometry: FieldGeometry,
    renderer: Renderer,
    /// The radiance that counts as white.
    white: f32,
}

/// Renders the views of a case one by one, with shared light, and with shared light and further
/// paths. Prints a table row per way, and per peer.
pub fn measure(options: &Options) -> Outcome {
    let (warnings, cancel) = (Collector::default(), Cancel::default());
    let task = Task::quiet(&warnings, &cancel);
    let bench = Bench::new(options, task)?;
    for &samples in &options.samples {
        let mut ways = [Kind::Alone, Kind::Shared, Kind::Further].map(|kind| Way::new(kind, samples));
        render(&bench, &mut ways, task)?;
        let peers = render_peers(&bench, options, samples)?;
        let [alone, shared, further] = &ways;
        let of = |way: &Way| Errors::new(way, alone, bench.white);
        let errors = [Errors::of_noise(alone, bench.white), of(shared), of(further)];
        for (way, error) in ways.iter().zip(&errors) {
            let ratio = alone.seconds * errors[0].all / (way.seconds * error.all);
            row(&bench.case, options, way, way.kind.name(), error, ratio);
        }
        for (name, way) in &peers {
            // For a peer, the column of the bias has the difference from our views, without noise.
            let Errors { bias, change, .. } = Errors::new(way, alone, bench.white);
            let error = Errors { bias, change, ..Errors::of_noise(way, bench.white) };
            let ratio = alone.seconds * errors[0].all / (way.seconds * error.all);
            row(&bench.case, options, way, name, &error, ratio);
        }
        if let Some(samples) = options.converged {
            compare_means(&bench, &ways, samples, task)?;
        }
    }
    Ok(())
}

/// Compares the mean radiance of a whole picture with that of a converged picture, in the two views
/// at opposite corners of the zone and in the middle view. Prints for each way the largest of these
/// three differences in standard deviations (σ), and the same difference in percent.
fn compare_means(bench: &Bench, ways: &[Way], samples: u32, task: Task<'_>) -> Outcome {
    let [rows, cols] = bench.geometry.grid.views();
    let views = [[0, 0], [rows / 2, cols / 2], [rows - 1, cols - 1]];
    let mut largest = vec![(0.0f64, 0.0f64); ways.len()];
    for view in views {
        // Render half of the samples with this seed, which no way uses.
        let half = |seed: u64| {
            let clamp = Some(CLAMP * bench.white);
            let samples = samples.div_ceil(2);
            let settings = Settings { samples, max_bounces: BOUNCES, seed, clamp, ..Settings::default() };
            bench.renderer.render_view(&bench.case.window, &bench.geometry, view, &settings, task)
        };
        let (truth, of_truth) = mean_of([&half(1 << 40)?, &half((1 << 40) + 1)?]);
        for (way, largest) in ways.iter().zip(&mut largest) {
            let number = view[0] * cols + view[1];
            let (mean, variance) = mean_of(way.pictures.each_ref().map(|pictures| &pictures[number]));
            let off = (mean - truth) / (variance + of_truth).sqrt();
            if off.abs() >= largest.1.abs() {
                *largest = (100.0 * (mean / truth - 1.0), off);
            }
        }
    }
    for (way, (percent, off)) in ways.iter().zip(largest) {
        let way = way.kind.name();
        println!("| {}, {way}: mean against {samples} samples | {percent:+.3} %, {off:+.1} σ |", bench.case.name);
    }
    Ok(())
}

/// Returns the mean of all values of two independent pictures, and its variance. Pixels are
/// independent of each other, so the variance of the mean follows from the variances of the pixels.
fn mean_of([a, b]: [&Tensor<3>; 2]) -> (f64, f64) {
    let count = a.data().len() as f64;
    let pairs = || a.data().chunks_exact(3).zip(b.data().chunks_exact(3));
    // the channels of a pixel depend on each other, so their sum is one value
    let sum = |pixel: &[f32]| pixel.iter().map(|value| f64::from(*value)).sum::<f64>();
    let total: f64 = pairs().map(|(a, b)| 0.5 * (sum(a) + sum(b))).sum();
    let variance: f64 = pairs().map(|(a, b)| 0.25 * (sum(a) - sum(b)).powi(2)).sum();
    (total / count, variance / (count * count))
}

/// Renders the views of a case in all four ways, at several numbers of samples. Prints a table row
/// per way and number of samples. The last column compares errors at equal time. It is the error
/// of views that are rendered one by one in the same time, divided by the error of the row's way.
pub fn filters(options: &Options) -> Outcome {
    let (warnings, cancel) = (Collector::default(), Cancel::default());
    let task = Task::quiet(&warnings, &cancel);
    let bench = Bench::new(options, task)?;
    let filters = [Kind::Shared, Kind::Further, Kind::Guided];
    let filtered = FILTERED.into_iter().flat_map(|samples| filters.map(|kind| (kind, samples)));
    let alone = ALONE.into_iter().map(|samples| (Kind::Alone, samples));
    let mut ways: Vec<Way> = alone.chain(filtered).map(|(kind, samples)| Way::new(kind, samples)).collect();
    render(&bench, &mut ways, task)?;
    let truth = &ways[ALONE.len() - 1];
    let white = bench.white;
    let of =
        |way: &Way| if way.kind == Kind::Alone { Errors::of_noise(way, white) } else { Errors::new(way, truth, white) };
    let errors: Vec<Errors> = ways.iter().map(of).collect();
    let points: Vec<[f64; 2]> =
        ways.iter().zip(&errors).take(ALONE.len()).map(|(way, error)| [way.seconds.ln(), error.all.ln()]).collect();
    for (way, error) in ways.iter().zip(&errors) {
        row(&bench.case, options, way, way.kind.name(), error, on_line(&points, way.seconds.ln()).exp() / error.all);
    }
    Ok(())
}

impl Bench {
    fn new(options: &Options, task: Task<'_>) -> Outcome<Self> {
        let case = Case::load(&options.scene, options.copies, options.size, options.own_materials, task)?;
        // the peers have no parallel projection that is oblique
        let projection = match options.peers.is_empty() {
            true => Projection::Oblique,
            false => case.geometry.grid.projection,
        };
        let geometry = field_of(&case, projection, options.views, options.fov_deg)?;
        let renderer = Renderer::new(case.scene.clone(), task)?;
        let middle = geometry.grid.views().map(|count| count / 2);
        let settings = Settings { samples: OF_WHITE, max_bounces: BOUNCES, ..Settings::default() };
        let white = white(&renderer.render_view(&case.window, &geometry, middle, &settings, task)?);
        Ok(Self { case, geometry, renderer, white })
    }
}

impl Kind {
    fn name(self) -> &'static str {
        match self {
            Self::Alone => "one by one",
            Self::Shared => "shared",
            Self::Further => "with further",
            Self::Guided => "guided",
        }
    }

    /// Renders all views of a bench.
    fn render(self, bench: &Bench, settings: Settings, task: Task<'_>) -> Result<Vec<Tensor<3>>, RenderError> {
        let Bench { case, geometry, renderer, .. } = bench;
        match self {
            Self::Alone => {
                let view = |view| renderer.render_view(&case.window, geometry, view, &settings, task);
                geometry.grid.iter().map(view).collect()
            }
            Self::Shared | Self::Further => {
                let settings = Settings { further_paths: self == Self::Further, ..settings };
                let split = |view| renderer.render_split(&case.window, geometry, view, &settings, task);
                let splits: Vec<_> = geometry.grid.iter().map(split).collect::<Result<_, _>>()?;
                let mut light = SharedLight::new(geometry, &settings);
                splits.iter().for_each(|split| light.add(split));
                let mean = light.averaged(task)?;
                Ok(splits.iter().enumerate().map(|(number, split)| mean.on(number, split)).collect())
            }
            Self::Guided => {
                let half = |view, half: u64| {
                    let seed = settings.seed.wrapping_add((1 + half) << 32);
                    let settings = Settings { samples: settings.samples.div_ceil(2), seed, ..settings };
                    renderer.render_view_and_features(&case.window, geometry, view, &settings, task)
                };
                let noisy = |view| {
                    let [a, b] = [half(view, 0)?, half(view, 1)?];
                    let features = a.features.joined(&b.features);
                    Ok(NoisyView { halves: [a.radiance, b.radiance], features })
                };
                let views: Vec<NoisyView> = geometry.grid.iter().map(noisy).collect::<Result<_, RenderError>>()?;
                Ok(denoise(geometry, &views, Window::default(), task)?)
            }
        }
    }
}

impl Way {
    fn new(kind: Kind, samples: u32) -> Self {
        Self { kind, samples, seconds: 0.0, pictures: Default::default() }
    }
}

/// Renders all ways once, and then all ways again with other seeds.
fn render(bench: &Bench, ways: &mut [Way], task: Task<'_>) -> Outcome {
    let count = ways.len() as u64;
    for round in 0..2 {
        for (number, way) in ways.iter_mut().enumerate() {
            let seed = count * round as u64 + number as u64;
            let (samples, clamp) = (way.samples, Some(CLAMP * bench.white));
            // the peers, which need perspective views, have neither a clamp nor roulette
            let settings = match bench.geometry.grid.projection {
                Projection::Oblique => Settings { samples, max_bounces: BOUNCES, seed, clamp, ..Settings::default() },
                Projection::Perspective { .. } => {
                    Settings { samples, max_bounces: BOUNCES, roulette_start: BOUNCES, seed, ..Settings::default() }
                }
            };
            let start = spent()?;
            way.pictures[round] = way.kind.render(bench, settings, task)?;
            way.seconds += 0.5 * (spent()? - start).as_secs_f64();
        }
    }
    Ok(())
}

/// Returns the geometry of a case's views, `views` = [rows, columns], over a zone of `fov_deg`. An
/// axis with one view has no zone.
fn field_of(case: &Case, projection: Projection, views: [usize; 2], fov_deg: f64) -> Outcome<FieldGeometry> {
    let [rows, cols] = views;
    let fov = [cols, rows].map(|count| if count > 1 { fov_deg } else { 0.0 });
    Ok(case.geometry.with_grid(ViewGrid::uniform(projection, [cols, rows], fov)?))
}

/// Renders the views with the peers, one by one, twice with independent seeds. Returns their names
/// and results. Only the first sampler of a peer is used.
fn render_peers(bench: &Bench, options: &Options, samples: u32) -> Outcome<Vec<(String, Way)>> {
    let folder = options.folder.join(format!("field-{}", bench.case.name));
    let mut results = Vec::new();
    for [python, script] in &options.peers {
        bench.case.export(&bench.geometry, &folder, false)?;
        let mut peer = match Peer::start(python, script, &folder) {
            Ok(peer) => peer,
            Err(error) => {
                println!("{} is left out: {error}", script.display());
                continue;
            }
        };
        let sampler = peer.samplers.first().cloned().ok_or("the renderer: expected a sampler's name, found none")?;
        let mut way = Way::new(Kind::Alone, samples);
        for (round, pictures) in way.pictures.iter_mut().enumerate() {
            for view in 0..bench.geometry.grid.iter().count() {
                let seed = (round * 100_000 + view + 1) as u32;
                let rendered = peer.render_view(view, &sampler, samples, seed, &folder.join("view.npy"))?;
                let size = [bench.geometry.rows, bench.geometry.cols, 3];
                let mut picture = Tensor::zeros(["row", "col", "rgb"], size);
                picture.data_mut().copy_from_slice(&rendered.picture);
                pictures.push(picture);
                way.seconds += 0.5 * rendered.cpu_s;
            }
        }
        results.push((format!("{}, one by one", peer.name), way));
    }
    Ok(results)
}

/// Returns the processor time that this process has used.
fn spent() -> Outcome<Duration> {
    let stat = std::fs::read_to_string("/proc/self/stat")?;
    // the name, in brackets, may contain spaces; user and system time are the 12th and 13th fields
    // after it
    let past_name = stat.rsplit(") ").next().unwrap_or_default();
    let ticks: Vec<u64> = past_name.split(' ').skip(11).take(2).map(str::parse).collect::<Result<_, _>>()?;
    Ok(Duration::from_millis(TICK_MS * ticks.iter().sum::<u64>()))
}

/// Returns the radiance that is taken as white: the fraction [`BELOW_WHITE`] of all values is at
/// most this.
fn white(picture: &Tensor<3>) -> f32 {
    let mut values = picture.data().to_vec();
    let place = ((values.len() - 1) as f64 * BELOW_WHITE) as usize;
    *values.select_nth_unstable_by(place, f32::total_cmp).1
}

impl Errors {
    /// Returns the errors of a way that has no bias. The mean of half the squared difference of two
    /// independent pictures is the variance of one picture.
    fn of_noise(way: &Way, white: f32) -> Self {
        let variances = variances(way, white);
        let worst = variances.iter().copied().fold(0.0, f64::max);
        Self { all: mean(&variances), worst, bias: 0.0, change: 0.0, of_mean: of_mean(way, white) }
    }

    /// Returns the errors against `truth`, a way that has no bias. Each value of a picture is
    /// compared with two independent pictures of `truth`. The product of the two differences has
    /// the picture's squared error as its mean; the noise of `truth` does not add to it.
    fn new(way: &Way, truth: &Way, white: f32) -> Self {
        let shown = |value: f32| f64::from(value / white);
        let of_view = |view: usize| {
            let [a, b] = [0, 1].map(|half: usize| truth.pictures[half][view].data());
            let of_half = |half: usize| {
                let own = way.pictures[half][view].data();
                let product = |i: usize| (shown(own[i]) - shown(a[i])) * (shown(own[i]) - shown(b[i]));
                (0..own.len()).map(product).sum::<f64>() / own.len() as f64
            };
            0.5 * (of_half(0) + of_half(1))
        };
        let errors: Vec<f64> = (0..truth.pictures[0].len()).map(of_view).collect();
        let sum = |way: &Way| -> f64 {
            way.pictures.iter().flatten().flat_map(|picture| picture.data()).map(|value| shown(*value)).sum()
        };
        let all = mean(&errors);
        Self {
            all,
            worst: errors.iter().copied().fold(0.0, f64::max),
            bias: (all - mean(&variances(way, white))).max(0.0),
            change: sum(way) / sum(truth) - 1.0,
            of_mean: of_mean(way, white),
        }
    }
}

/// Returns the variance of every view.
fn variances(way: &Way, white: f32) -> Vec<f64> {
    let shown = |value: f32| f64::from(value / white);
    let [first, second] = &way.pictures;
    let of_view = |(a, b): (&Tensor<3>, &Tensor<3>)| {
        let pairs = a.data().iter().zip(b.data());
        pairs.map(|(a, b)| 0.5 * (shown(*a) - shown(*b)).powi(2)).sum::<f64>() / a.data().len() as f64
    };
    first.iter().zip(second).map(of_view).collect()
}

/// Returns the variance of the mean of all views.
fn of_mean(way: &Way, white: f32) -> f64 {
    let [first, second] = way.pictures.each_ref().map(|views| {
        let mut sum = vec![0.0f64; views[0].data().len()];
        for view in views {
            sum.iter_mut().zip(view.data()).for_each(|(sum, value)| *sum += f64::from(value / white));
        }
        sum.iter().map(|sum| sum / views.len() as f64).collect::<Vec<f64>>()
    });
    first.iter().zip(&second).map(|(a, b)| 0.5 * (a - b).powi(2)).sum::<f64>() / first.len() as f64
}

fn mean(values: &[f64]) -> f64 {
    values.iter().sum::<f64>() / values.len() as f64
}

/// Returns the value at x of the polyline through `points`, which are in order of x. Outside of the
/// points, the first or the last segment is extended as a straight line.
fn on_line(points: &[[f64; 2]], x: f64) -> f64 {
    let next = points.iter().position(|[at, _]| *at > x).unwrap_or(points.len() - 1).max(1);
    let ([x0, y0], [x1, y1]) = (points[next - 1], points[next]);
    y0 + (y1 - y0) * (x - x0) / (x1 - x0)
}

fn row(case: &Case, options: &Options, way: &Way, name: &str, error: &Errors, ratio: f64) {
    let [rows, cols] = options.views;
    let materials = if options.own_materials { "own materials" } else { "diffuse" };
    println!(
        "| {}, {materials} | {rows} × {cols}, {}° | {} | {} | {:.2} | {:.2e} | {:.2e} | {:.2e} | {:+.2} % | {:.2e} | {ratio:.2} |",
        case.name,
        options.fov_deg,
        way.samples,
        name,
        way.seconds,
        error.all,
        error.worst,
        error.bias,
        100.0 * error.change,
        error.of_mean,
    );
}
