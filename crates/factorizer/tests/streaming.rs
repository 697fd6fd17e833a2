//! Tests targets in a mapped file: the memory that a solve takes besides the target must agree with
//! `held_bytes`.

use std::alloc::{GlobalAlloc, Layout, System};
use std::io::Write;
use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};

use lumistack_core::{Cancel, Collector, Task, Tensor};
use lumistack_display::{Backlight, Display, FieldGeometry, LensletBacklight, LightField, Sampling, Weights};
use lumistack_factorizer::{Problem, Settings, factorize, held_bytes, weight_bytes};
use lumistack_simd::{float_from_half, nearest_half};

/// Counts the bytes that all threads hold.
struct Counting;

static HELD: AtomicUsize = AtomicUsize::new(0);
static MOST: AtomicUsize = AtomicUsize::new(0);

// SAFETY: the system's allocator does all the work
unsafe impl GlobalAlloc for Counting {
    unsafe fn alloc(&self, layout: Layout) -> *mut u8 {
        MOST.fetch_max(HELD.fetch_add(layout.size(), Ordering::Relaxed) + layout.size(), Ordering::Relaxed);
        // SAFETY: guaranteed by the caller
        unsafe { System.alloc(layout) }
    }

    unsafe fn alloc_zeroed(&self, layout: Layout) -> *mut u8 {
        MOST.fetch_max(HELD.fetch_add(layout.size(), Ordering::Relaxed) + layout.size(), Ordering::Relaxed);
        // SAFETY: guaranteed by the caller
        unsafe { System.alloc_zeroed(layout) }
    }

    unsafe fn dealloc(&self, at: *mut u8, layout: Layout) {
        HELD.fetch_sub(layout.size(), Ordering::Relaxed);
        // SAFETY: guaranteed by the caller
        unsafe { System.dealloc(at, layout) }
    }
}

#[global_allocator]
static ALLOCATOR: Counting = Counting;

/// Returns the result of `work`, and the peak of the bytes that it holds.
fn peak<T>(work: impl FnOnce() -> T) -> (T, u64) {
    let before = HELD.load(Ordering::Relaxed);
    MOST.store(before, Ordering::Relaxed);
    let result = work();
    (result, (MOST.load(Ordering::Relaxed) - before) as u64)
}

/// Returns a light field in a mapped file: waves and edges that move from view to view, rounded to
/// half floats.
fn on_disk(display: &Display) -> LightField {
    /// Values in a mapped file.
    struct Mapped(memmap2::Mmap);

    impl AsRef<[f32]> for Mapped {
        fn as_ref(&self) -> &[f32] {
            // SAFETY: any bytes are valid numbers
            unsafe { self.0.align_to::<f32>().1 }
        }
    }

    let geometry = display.geometry().unwrap();
    let (cols, size) = (geometry.cols, geometry.rows * geometry.cols);
    let mut file = tempfile::tempfile().unwrap();
    for [view_y, view_x] in geometry.grid.iter() {
        let value = |i: usize, channel: usize| {
            let (x, y) = ((i % cols + 3 * view_x) as f32, (i / cols + 2 * view_y) as f32);
            let edge = if (x as usize / 16 + y as usize / 12).is_multiple_of(2) { 0.3 } else { 0.0 };
            let wave = 0.3 + 0.25 * (x * 0.11 + channel as f32).sin() * (y * 0.07).cos() + edge;
            float_from_half(nearest_half(wave)).to_ne_bytes()
        };
        let bytes: Vec<u8> = (0..size).flat_map(|i| (0..3).flat_map(move |channel| value(i, channel))).collect();
        file.write_all(&bytes).unwrap();
    }
    // SAFETY: the file has no name, so no other process writes it
    let mapped = Mapped(unsafe { memmap2::Mmap::map(&file) }.unwrap());
    let [views_y, views_x] = geometry.grid.views();
    let shape = [views_y, views_x, geometry.rows, geometry.cols, 3];
    LightField::new(geometry, Tensor::lent(LightField::AXES, shape, Arc::new(mapped)).unwrap()).unwrap()
}

fn uniform(views: usize, frames: usize) -> Display {
    Display { brightness: 0.3, ..Display::uniform([128, 100], 0.5, [views; 2], [14.0; 2], &[-8.0, 0.0, 8.0], frames) }
}

fn directional() -> Display {
    let backlight = LensletBacklight::new(-8.5, [24, 19], 2.7, [5; 2], [40.0; 2]);
    let display = Display::uniform([128, 100], 0.5, [5; 2], [40.0; 2], &[0.0], 2);
    Display { brightness: 0.3, backlight: Backlight::Lenslets(backlight), ..display }
}

/// Returns weights of single rays, from 1 down to 1/997, again and again along the rows.
fn weights_of_rays(geometry: &FieldGeometry) -> Weights {
    let [views_y, views_x] = geometry.grid.views();
    let shape = [views_y, views_x, geometry.rows, geometry.cols];
    let values = (0..shape.iter().product::<usize>()).map(|i| 1.0 / (1 + i % 997) as f32).collect();
    Weights::PerRay(Tensor::from_vec(["view_y", "view_x", "row", "col"], shape, values).unwrap())
}

#[test]
fn a_solve_holds_no_more_than_is_said_before() {
    // displays that need additional memory for different reasons
    let few_bits = {
        let mut display = uniform(5, 3);
        display.layers.iter_mut().for_each(|layer| layer.bits = Some(4));
        display
    };
    let blurred = {
        let mut display = uniform(5, 2);
        display.layers[1].blur_px = 0.6;
        display
    };
    let cases = [
        ("many views", uniform(13, 2)),
        ("few bits", few_bits),
        ("blurred", blurred),
        ("between pixels", Display { sampling: Sampling::Bilinear, ..uniform(5, 2) }),
        ("directional", directional()),
        ("weighted", uniform(13, 2)),
    ];
    for (name, display) in cases {
        let field = on_disk(&display);
        let is_weighted = name == "weighted";
        let weights = if is_weighted { weights_of_rays(field.geometry()) } else { Weights::Uniform };
        let (warnings, cancel) = (Collector::default(), Cancel::default());
        let settings = Settings { iterations: 3, ..Settings::default() };
        let solve = |target| {
            let problem = Problem { display: &display, target, weights: &weights };
            factorize(&problem, &settings, None, Task::quiet(&warnings, &cancel), &mut |_| {}).unwrap()
        };
        // a target in a file must give the same patterns as the same target in memory
        let (solved, held) = peak(|| solve(&field));
        let values = field.radiance().data().to_vec();
        let radiance = Tensor::from_vec(LightField::AXES, field.radiance().shape(), values).unwrap();
        let in_memory = LightField::new(field.geometry().clone(), radiance).unwrap();
        assert!(solve(&in_memory) == solved, "{name}: other patterns than from memory");
        // the bound must hold, and must not exceed the held bytes by more than a factor of 4
        let weighted = if is_weighted { weight_bytes(field.geometry()) } else { 0 };
        let said = held_bytes(&display, field.geometry(), rayon::current_num_threads()) + weighted;
        assert!(held <= said, "{name}: {held} bytes were held, held_bytes returned {said}");
        assert!(said <= 4 * held, "{name}: held_bytes returned {said}, only {held} bytes were held");
        let whole = 4 * field.radiance().data().len() as u64;
        assert!(name != "many views" || held < whole, "{held} bytes held, the whole light field would be {whole}");
    }
}
