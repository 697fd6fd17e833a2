//! Tests tiles: a tile's rays read the same values as in the whole display. If a tile is solved
//! with fixed borders, the objective of the whole display falls by as much as the objective of the
//! tile.

use lumistack_core::{Cancel, Collector, Task};
use lumistack_display::{LayerColour, LayerStack, RayMap, Region, Tap, Tile, Tiling, Weights};

use crate::problems::{Kind, Owned, random};
use lumistack_factorizer::device::Updater;
use lumistack_factorizer::internals::Engine;
use lumistack_factorizer::{FactorizeError, Problem, Settings, factorize, factorize_tile, random_start};

/// Tolerance of a decrease of the objective, relative to the previous objective. The decreases for
/// a tile and for the whole display are summed in f32, so they differ by rounding.
const GAIN_TOLERANCE: f64 = 2e-5;
const SEEDS: [u64; 3] = [1, 2, 3];

fn each(mut check: impl FnMut(Kind, &Owned, &Tiling)) {
    for kind in Kind::ALL {
        for seed in SEEDS {
            let owned = random(kind, seed);
            for tiles in [[1, 1], [2, 1], [3, 4]] {
                let tiling = Tiling::new(&owned.display, owned.target.geometry(), tiles);
                check(kind, &owned, &tiling);
            }
        }
    }
}

fn regions(tile: &Tile, of: fn(&lumistack_display::TilePart) -> &Region) -> Vec<Region> {
    tile.parts.iter().map(|part| of(part).clone()).collect()
}

/// Returns the pixels of a layer that a ray reads, [rows, columns]; `None` if the ray misses the
/// layer.
fn read(map: &RayMap, layer: usize, view: [usize; 2], row: usize, col: usize) -> Option<[[usize; 2]; 2]> {
    let pair = |tap: Tap| (!tap.is_missed()).then_some([tap.first as usize, tap.second as usize]);
    let map = &map.layers[layer];
    pair(map.y.of_view(view[0])[row]).zip(pair(map.x.of_view(view[1])[col])).map(|(y, x)| [y, x])
}

#[test]
fn every_pixel_is_one_tiles_own_and_all_rays_through_free_pixels_are_the_tiles() {
    each(|kind, owned, tiling| {
        let (geometry, map) = (owned.target.geometry(), tiling.map());
        let tiles: Vec<Tile> = (0..tiling.count()).map(|number| tiling.tile(number)).collect();
        // tiles partition the pixels of every layer and of the lenslets
        for (n, [rows, cols]) in tiles[0].whole.iter().copied().enumerate() {
            for (row, col) in (0..rows).flat_map(|row| (0..cols).map(move |col| (row, col))) {
                let owners = tiles.iter().filter(|tile| {
                    let Region { rows, cols } = &tile.parts[n].own;
                    rows.contains(&row) && cols.contains(&col)
                });
                assert_eq!(owners.count(), 1, "{kind:?}, part {n}, pixel {row}, {col}");
            }
        }
        // each tile holds all pixels that its rays read
        for (number, tile) in tiles.iter().enumerate() {
            let within = tile.map(map);
            for part in &tile.parts {
                for inner in [&part.own, &part.free] {
                    assert!(inner.is_empty() || inner.common(&part.held) == *inner && !part.held.is_empty());
                }
                assert!(part.own.is_empty() || part.own.common(&part.free) == part.own, "{kind:?}");
            }
            // for every ray and layer, compare the pixels that the ray reads in the tile and in the
            // whole display
            for view in geometry.grid.iter() {
                for (row, col) in (0..geometry.rows).flat_map(|r| (0..geometry.cols).map(move |c| (r, c))) {
                    let Region { rows, cols } = &tile.field;
                    let is_inside = rows.contains(&row) && cols.contains(&col);
                    for (n, part) in tile.parts.iter().enumerate().take(map.layers.len()) {
                        let found = read(map, n, view, row, col);
                        if is_inside {
                            let of_tile = read(&within, n, view, row - rows.start, col - cols.start);
                            let first = [part.held.rows.start, part.held.cols.start];
                            let of_tile = of_tile.map(|both| [0, 1].map(|axis| both[axis].map(|i| i + first[axis])));
                            assert_eq!(of_tile, found, "{kind:?}, tile {number}, layer {n}");
                            let [y, x] = found.unwrap_or([[part.held.rows.start; 2], [part.held.cols.start; 2]]);
                            assert!(
                                y.iter().all(|y| part.held.rows.contains(y))
                                    && x.iter().all(|x| part.held.cols.contains(x))
                            );
                        } else if let Some([y, x]) = found {
                            let is_free =
                                |y: usize, x: usize| part.free.rows.contains(&y) && part.free.cols.contains(&x);
                            assert!(!y.iter().any(|y| x.iter().any(|x| is_free(*y, *x))), "{kind:?}, tile {number}");
                        }
                    }
                }
            }
            // the map of the tile's own geometry must equal the tile's section of the whole
            // display's map
            let display = tile.display(&owned.display, geometry);
            display.check().unwrap_or_else(|error| panic!("{kind:?}: {error}"));
            let anew = RayMap::new(&display, &tile.geometry(geometry));
            for (anew, map) in anew.layers.iter().zip(&within.layers) {
                for (axis, views) in [(&anew.x, geometry.grid.slope_x.len()), (&anew.y, geometry.grid.slope_y.len())] {
                    let of_map = if std::ptr::eq(axis, &anew.x) { &map.x } else { &map.y };
                    for (a, b) in (0..views).flat_map(|view| axis.of_view(view).iter().zip(of_map.of_view(view))) {
                        let place = |tap: &Tap| f64::from(tap.first) + f64::from(tap.t);
                        let both_missed = a.is_missed() && b.is_missed();
                        assert!(both_missed || (place(a) - place(b)).abs() < 1e-3, "{kind:?}: {a:?} {b:?}");
                    }
                }
            }
            let around = tiling.around(number);
            assert!(around.contains(&number) && around.is_sorted() && around.iter().all(|other| *other < tiles.len()));
        }
    });
}

fn objective(problem: &Problem, stack: &LayerStack) -> f64 {
    Engine::new(problem, stack.clone(), 0.0).unwrap().objective().value
}

#[test]
fn what_a_tile_gains_with_fixed_borders_the_whole_gains() {
    let (warnings, cancel) = (Collector::default(), Cancel::default());
    let task = Task::quiet(&warnings, &cancel);
    each(|kind, owned, tiling| {
        let (problem, geometry) = (owned.problem(), owned.target.geometry());
        let mut stack = random_start(&owned.display, 5);
        for (layer, values) in owned.display.layers.iter().zip(&mut stack.layers) {
            let [low, high] = layer.range();
            values.data_mut().iter_mut().for_each(|value| *value = value.clamp(low, high));
            if layer.colour == LayerColour::Mono {
                values.data_mut().as_chunks_mut::<3>().0.iter_mut().for_each(|pixel| *pixel = [pixel[0]; 3]);
            }
        }
        for number in 0..tiling.count() {
            let tile = tiling.tile(number);
            let (held, free) = (regions(&tile, |part| &part.held), regions(&tile, |part| &part.free));
            let (display, target) = (tile.display(&owned.display, geometry), tile.light_field(&owned.target));
            let Some(weights) = tile.weights(&owned.weights) else { continue };
            let of_tile = Problem { display: &display, target: &target, weights: &weights };
            let settings =
                Settings { solver: "block-exact".into(), iterations: 2, levels: false, ..Settings::default() };
            // A warm start raises black values to the floor. Do the same for the patterns that are
            // compared.
            let tensors = stack.layers.iter_mut().map(|layer| layer.data_mut());
            for values in tensors.chain(stack.emission.iter_mut().map(|emission| emission.data_mut())) {
                values.iter_mut().for_each(|value| *value = value.max(lumistack_factorizer::FLOOR));
            }
            let before = objective(&problem, &stack);
            let start = stack.cut(&held);
            let solved =
                factorize_tile(&of_tile, (&tile, tiling.map()), &settings, (Some(&start), true), task, &mut |_| {});
            let solved = match solved {
                Err(FactorizeError::NoRays) => continue,
                solved => solved.unwrap(),
            };
            let mut fixed = solved.stack.clone();
            fixed.paste(&held, &start.cut(&free_within(&tile)), &free);
            assert!(differ(&fixed, &start) < 1e-6, "{kind:?}: a border has changed");
            let whole: Vec<_> =
                tile.whole.iter().map(|&[rows, cols]| Region { rows: 0..rows, cols: 0..cols }).collect();
            stack.paste(&whole, &solved.stack, &held);
            let gain = before - objective(&problem, &stack);
            let [first, last] = [solved.history[0], solved.history[solved.history.len() - 1]].map(|at| at.objective);
            let error = (gain - (first - last)).abs() / before.max(f64::MIN_POSITIVE);
            assert!(error < GAIN_TOLERANCE, "{kind:?}, tile {number} of {}: {gain} {}", tiling.count(), first - last);
            assert!(gain > -GAIN_TOLERANCE * before);
        }
    });
}

fn free_within(tile: &Tile) -> Vec<Region> {
    tile.parts.iter().map(|part| part.free.within(&part.held)).collect()
}

fn differ(a: &LayerStack, b: &LayerStack) -> f32 {
    let values = |stack: &LayerStack| {
        let layers = stack.layers.iter().map(|layer| layer.data().to_vec());
        layers.chain(stack.emission.iter().map(|emission| emission.data().to_vec())).flatten().collect::<Vec<_>>()
    };
    values(a).iter().zip(values(b)).map(|(a, b)| (a - b).abs()).fold(0.0, f32::max)
}

#[test]
fn a_tile_that_is_all_is_solved_as_all() {
    let (warnings, cancel) = (Collector::default(), Cancel::default());
    let task = Task::quiet(&warnings, &cancel);
    for kind in [Kind::Plain, Kind::Wide, Kind::LensletsDark, Kind::Responses, Kind::RayWeights] {
        let owned = random(kind, 4);
        let tiling = Tiling::new(&owned.display, owned.target.geometry(), [1, 1]);
        let tile = tiling.tile(0);
        let settings = Settings { iterations: 3, ..Settings::default() };
        let whole = factorize(&owned.problem(), &settings, None, task, &mut |_| {}).unwrap();
        let of_tile =
            factorize_tile(&owned.problem(), (&tile, tiling.map()), &settings, (None, false), task, &mut |_| {});
        assert!(whole.stack == of_tile.unwrap().stack, "{kind:?}");
    }
}

#[test]
fn tiles_begin_as_the_whole_does() {
    let owned = random(Kind::MixedLayers, 3);
    let geometry = owned.target.geometry();
    let tiling = Tiling::new(&owned.display, geometry, [2, 2]);
    let settings = Settings {
        start: Some(lumistack_factorizer::StartKind::Random),
        iterations: 0,
        coarse_levels: Some(0),
        ..Settings::default()
    };
    let whole = random_start(&owned.display, settings.seed);
    let (warnings, cancel) = (Collector::default(), Cancel::default());
    for number in 0..tiling.count() {
        let tile = tiling.tile(number);
        let (display, target) = (tile.display(&owned.display, geometry), tile.light_field(&owned.target));
        let problem = Problem { display: &display, target: &target, weights: &Weights::Uniform };
        let task = Task::quiet(&warnings, &cancel);
        let begun =
            factorize_tile(&problem, (&tile, tiling.map()), &settings, (None, false), task, &mut |_| {}).unwrap();
        assert!(differ(&begun.stack, &whole.cut(&regions(&tile, |part| &part.held))) < 1e-3);
    }
}
