//! Views whose light is averaged over all that see it, beside the same views one by one, at equal
//! squared error.

use std::time::Duration;

use lumistack_core::{Cancel, Collector, Task, Tensor};
use lumistack_display::{FieldGeometry, Projection, ViewGrid};
use lumistack_pathtracer::denoise::SharedLight;
use lumistack_pathtracer::{Renderer, Settings};

use crate::case::{Case, Outcome};
use crate::{BOUNCES, Options};

/// Share of the values that are at most white. Brighter values do not count as errors: no display
/// shows them, and a few would hide all others.
const BELOW_WHITE: f64 = 0.99;
/// Tick of `/proc/self/stat` in milliseconds.
const TICK_MS: u64 = 10;

/// One way to render a light field.
struct Way {
    name: &'static str,
    /// Processor seconds, the mean of both renders.
    seconds: f64,
    /// Views, twice, by independent seeds.
    pictures: [Vec<Tensor<3>>; 2],
}

/// Renders the views of a case in both ways, twice each, and prints a table row per way.
pub fn measure(options: &Options) -> Outcome {
    let (warnings, cancel) = (Collector::default(), Cancel::default());
    let task = Task::quiet(&warnings, &cancel);
    let case = Case::load(&options.scene, options.copies, options.size, options.own_materials, task)?;
    let geometry = field_of(&case, options.views, options.fov_deg)?;
    let renderer = Renderer::new(case.scene.clone(), task)?;
    for &samples in &options.samples {
        let settings = |seed| Settings { samples, max_bounces: BOUNCES, seed, ..Settings::default() };
        let mut ways = ["one by one", "shared"].map(|name| Way { name, seconds: 0.0, pictures: Default::default() });
        for round in 0..2 {
            for (number, way) in ways.iter_mut().enumerate() {
                let start = spent()?;
                let settings = settings(2 * round as u64 + number as u64);
                way.pictures[round] = if number == 0 {
                    let view = |view| renderer.render_view(&case.window, &geometry, view, &settings, task);
                    geometry.grid.iter().map(view).collect::<Result<_, _>>()?
                } else {
                    let split = |view| renderer.render_split(&case.window, &geometry, view, &settings, task);
                    let splits: Vec<_> = geometry.grid.iter().map(split).collect::<Result<_, _>>()?;
                    let mut light = SharedLight::new(&geometry);
                    splits.iter().for_each(|split| light.add(split));
                    light.averaged(task)?.iter().zip(&splits).map(|(light, split)| light.on(split)).collect()
                };
                way.seconds += 0.5 * (spent()? - start).as_secs_f64();
            }
        }
        report(&case, options, &ways, samples);
    }
    Ok(())
}

/// Views of a case, of parallel rays over a zone; an axis with one view has no zone.
fn field_of(case: &Case, views: [usize; 2], fov_deg: f64) -> Outcome<FieldGeometry> {
    let [fov_y, fov_x] = views.map(|count| if count > 1 { fov_deg } else { 0.0 });
    Ok(case.geometry.with_grid(ViewGrid::uniform(Projection::Oblique, views, [fov_x, fov_y])?))
}

/// Time of the processors that this process has spent.
fn spent() -> Outcome<Duration> {
    let stat = std::fs::read_to_string("/proc/self/stat")?;
    // the name, in brackets, may hold spaces; user and system time are the twelfth and thirteenth
    // field past it
    let past_name = stat.rsplit(") ").next().unwrap_or_default();
    let ticks: Vec<u64> = past_name.split(' ').skip(11).take(2).map(str::parse).collect::<Result<_, _>>()?;
    Ok(Duration::from_millis(TICK_MS * ticks.iter().sum::<u64>()))
}

fn report(case: &Case, options: &Options, ways: &[Way; 2], samples: u32) {
    let truth = &ways[0].pictures;
    let mut values: Vec<f32> = truth[0].iter().flat_map(|picture| picture.data().iter().copied()).collect();
    let place = ((values.len() - 1) as f64 * BELOW_WHITE) as usize;
    let white = *values.select_nth_unstable_by(place, f32::total_cmp).1;
    let shown = |value: f32| f64::from((value / white).min(1.0));
    // the mean over pixels of a product of two differences
    let mean = |view: usize, product: &dyn Fn(usize) -> f64| {
        let count = truth[0][view].data().len();
        (0..count).map(product).sum::<f64>() / count as f64
    };
    let at = |pictures: &[Vec<Tensor<3>>; 2], half: usize, view: usize, i: usize| shown(pictures[half][view].data()[i]);
    // half the squared difference of independent pictures is their variance
    let variance = |way: &Way, view: usize| {
        mean(view, &|i| 0.5 * (at(&way.pictures, 0, view, i) - at(&way.pictures, 1, view, i)).powi(2))
    };
    // differences to two independent pictures without bias: their product is the squared error,
    // bias included, without the noise of those
    let error = |way: &Way, view: usize| {
        let of = |half: usize| {
            mean(view, &|i| {
                let own = at(&way.pictures, half, view, i);
                (own - at(truth, 0, view, i)) * (own - at(truth, 1, view, i))
            })
        };
        0.5 * (of(0) + of(1))
    };
    let [rows, cols] = options.views;
    let materials = if options.own_materials { "own materials" } else { "diffuse" };
    let mut first = None;
    for (number, way) in ways.iter().enumerate() {
        let views = 0..truth[0].len();
        let errors: Vec<f64> =
            views.clone().map(|view| if number == 0 { variance(way, view) } else { error(way, view) }).collect();
        let noise: f64 = views.map(|view| variance(way, view)).sum::<f64>() / errors.len() as f64;
        let all = errors.iter().sum::<f64>() / errors.len() as f64;
        let worst = errors.iter().copied().fold(0.0, f64::max);
        let cost = way.seconds * all;
        let ratio = *first.get_or_insert(cost) / cost;
        println!(
            "| {}, {materials} | {rows} × {cols}, {}° | {samples} | {} | {:.2} | {all:.2e} | {worst:.2e} | {:.2e} | {ratio:.2} |",
            case.name,
            options.fov_deg,
            way.name,
            way.seconds,
            (all - noise).max(0.0),
        );
    }
}
