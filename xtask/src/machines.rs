//! Runs the tests of vector kernels for other machines, which compare the kernels with oracles:
//! NEON of ARM under emulation, and simd128 of WebAssembly in Node.js.

use crate::tools::{Outcome, apt, command, output_of, root, run, skipped};

/// A machine, and the programs that its tests need in addition to the Rust target. Each program has
/// the Debian package that contains it.
struct Machine {
    target: &'static str,
    programs: &'static [(&'static str, &'static str)],
    linker: Option<&'static str>,
    runner: String,
    flags: &'static str,
}

/// The packages with vector kernels. Each has options for cargo, and a text that the names of its
/// kernel tests contain.
const TESTS: [(&str, &[&str], &str); 3] = [
    ("lumistack-simd", &[], ""),
    ("lumistack-factorizer", &["--no-default-features"], "updates"),
    ("lumistack-pathtracer", &[], "bvh"),
];

/// Runs the tests on every machine whose requirements can be installed.
pub fn check() -> Outcome {
    let wasi = format!("node --no-warnings {}", root().join("xtask/wasi.mjs").display());
    let machines = [
        Machine {
            target: "aarch64-unknown-linux-gnu",
            programs: &[
                ("qemu-aarch64", "qemu-user"),
                ("aarch64-linux-gnu-gcc", "gcc-aarch64-linux-gnu libc6-dev-arm64-cross"),
            ],
            linker: Some("aarch64-linux-gnu-gcc"),
            runner: "qemu-aarch64 -L /usr/aarch64-linux-gnu".into(),
            flags: "",
        },
        Machine {
            target: "wasm32-wasip1",
            programs: &[("node", "nodejs")],
            linker: None,
            runner: wasi,
            flags: "-Ctarget-feature=+simd128",
        },
    ];
    machines.iter().try_for_each(|machine| {
        if let Err(missing) = machine.fetch() {
            skipped(machine.target, &missing);
            return Ok(());
        }
        TESTS.iter().try_for_each(|(package, options, names)| machine.test(package, options, names))
    })
}

impl Machine {
    fn fetch(&self) -> Outcome {
        let has = |program: &str| output_of(command(program).arg("--version")).is_some();
        let missing: Vec<&str> = self
            .programs
            .iter()
            .filter(|(program, _)| !has(program))
            .flat_map(|(_, packages)| packages.split(' '))
            .collect();
        if !missing.is_empty() {
            apt(&missing, &format!("run the tests of {}", self.target))?;
        }
        run(command("rustup").args(["target", "add", self.target]))
    }

    fn test(&self, package: &str, options: &[&str], names: &str) -> Outcome {
        let variable = |key: &str| format!("CARGO_TARGET_{}_{key}", self.target.to_uppercase().replace('-', "_"));
        let mut cargo = command("cargo");
        cargo.args(["test", "--target", self.target, "--package", package, "--lib"]).args(options);
        // run one test after another, since the WebAssembly machine has no threads
        cargo.args(["--", "--test-threads=1", "--nocapture", names]);
        cargo.env(variable("RUNNER"), &self.runner).env("RUSTFLAGS", self.flags);
        if let Some(linker) = self.linker {
            cargo.env(variable("LINKER"), linker);
        }
        run(&mut cargo)
    }
}
