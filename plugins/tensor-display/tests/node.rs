//! Tests that the node returns the factorizer's result, and that its schema has the factorizer's
//! defaults, solvers and starts.

use lumistack_factorizer::{AUTO, Problem, Settings, StartKind, factorize, solvers};
use lumistack_plugin::core::{Cancel, Collector, Task, Tensor};
use lumistack_plugin::display::{Display, Weights};
use lumistack_plugin::{Kind, PluginError};
use lumistack_plugin_tensor_display::PLUGIN;
use lumistack_plugin_testkit::serve::{NodeData, Plugin, make_stack};
use lumistack_plugin_testkit::{MemoryHost, conformance_but_for, random_field};

fn display() -> Display {
    Display::uniform([16, 12], 1.0, [3, 3], [16.0, 12.0], &[-4.0, 4.0], 3)
}

#[test]
fn conforms() {
    // These parameters keep their defaults, since their largest value, four billion iterations,
    // would take too long.
    conformance_but_for(&PLUGIN, &["iterations", "coarse_iterations"]).unwrap();
}

#[test]
fn its_result_is_that_of_the_factorizer() {
    let display = display();
    let field = random_field(&display).unwrap();
    let (warnings, cancel) = (Collector::default(), Cancel::default());
    let task = Task::quiet(&warnings, &cancel);
    // make weights that differ from view to view, and a warm start
    let per_view: Vec<f32> = (0..9).map(|n| 0.1 + n as f32 / 7.0).collect();
    let per_view = Weights::PerView(Tensor::from_vec(["view_y", "view_x"], [3, 3], per_view).unwrap());
    let warm = {
        let problem = Problem { display: &display, target: &field, weights: &Weights::Uniform };
        let settings = Settings { iterations: 1, seed: 9, ..Settings::default() };
        factorize(&problem, &settings, None, task, &mut |_| {}).unwrap().stack
    };
    // compare patterns, steps and summary with those of the factorizer
    let plugin = Plugin::compiled_in(&PLUGIN).unwrap();
    for (solver, start, weights, warm) in [
        (AUTO, AUTO, &Weights::Uniform, None),
        ("multiplicative", "smooth", &per_view, None),
        ("block-exact", "random", &Weights::Uniform, Some(&warm)),
    ] {
        let settings = Settings {
            solver: solver.into(),
            iterations: 4,
            seed: u64::MAX,
            start: StartKind::from_name(start),
            ..Settings::default()
        };
        let problem = Problem { display: &display, target: &field, weights };
        let wanted = factorize(&problem, &settings, warm, task, &mut |_| {}).unwrap();
        let params = format!(r#"{{"solver": "{solver}", "iterations": 4, "start": "{start}"}}"#);
        let node = NodeData { weights, start: warm, seed: u64::MAX, ..NodeData::new(&display, &field) };
        let made = make_stack(&plugin, &MemoryHost::new(), &params, &node).unwrap();
        assert!(made.stack == wanted.stack, "{solver}");
        let steps: Vec<_> = made.steps.iter().map(|(at, _)| (at.iteration, at.objective, at.psnr_view)).collect();
        let history: Vec<_> = wanted.history.iter().map(|at| (at.iteration, at.objective, at.psnr_view)).collect();
        assert_eq!(steps, history, "{solver}");
        let solution = made.solution.unwrap();
        assert_eq!((solution.solver, solution.kkt_residual), (wanted.settings.solver, wanted.kkt_residual));
        assert_eq!(solution.start == "warm", warm.is_some());
    }
}

#[test]
fn the_words_are_those_of_the_factorizer() {
    let plugin = Plugin::compiled_in(&PLUGIN).unwrap();
    let options = |name: &str| {
        let param = plugin.info().schema.params.iter().find(|param| param.name == name).unwrap();
        let Kind::Choice { options, .. } = &param.kind else { panic!("{name} is a choice") };
        options.iter().map(|option| option.value.clone()).collect::<Vec<_>>()
    };
    let all = |names: Vec<&str>| [AUTO].into_iter().chain(names).map(String::from).collect::<Vec<_>>();
    assert_eq!(options("solver"), all(solvers().iter().map(|solver| solver.name()).collect()));
    assert_eq!(options("start"), all(StartKind::ALL.iter().map(|(name, _)| *name).collect()));
}

#[test]
fn a_host_can_stop_it() {
    let display = display();
    let field = random_field(&display).unwrap();
    let host = MemoryHost::new();
    let plugin = Plugin::compiled_in(&PLUGIN).unwrap();
    let result = std::thread::scope(|scope| {
        scope.spawn(|| {
            std::thread::sleep(std::time::Duration::from_millis(100));
            host.cancel();
        });
        make_stack(&plugin, &host, r#"{"iterations": 100000000}"#, &NodeData::new(&display, &field))
    });
    assert_eq!(result.err(), Some(PluginError::Cancelled));
    assert_eq!(host.stages(), (vec!["factorize".to_string()], 0));
}
