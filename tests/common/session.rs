//! Windowing sessions without hardware: sway with headless outputs, Xorg with its dummy driver, and
//! a nested sway. The outputs of a nested sway are windows of another session. Each server is a
//! child process of the test, and ends with the test.

#![allow(dead_code, reason = "every test file uses a part of this")]

use std::path::PathBuf;
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};

/// Name, [columns, rows] and [x, y] of an output.
pub type Screen = (&'static str, [usize; 2], [i32; 2]);

/// Outputs of a sway session that is not nested.
pub const SWAY: [Screen; 3] =
    [("HEADLESS-1", [320, 240], [0, 0]), ("HEADLESS-2", [400, 300], [320, 0]), ("HEADLESS-3", [640, 360], [720, 0])];

/// Outputs of an Xorg session.
pub const XORG: [Screen; 3] =
    [("DUMMY0", [320, 240], [0, 0]), ("DUMMY1", [400, 300], [320, 0]), ("DUMMY2", [640, 360], [720, 0])];

/// Outputs of a sway session nested in another sway. Each output is a window of the outer session,
/// so closing the window unplugs the output.
pub const NESTED: [Screen; 3] =
    [("WL-1", [320, 240], [0, 0]), ("WL-2", [400, 300], [320, 0]), ("WL-3", [640, 360], [720, 0])];

/// Outputs of a sway session nested in Xorg. This sway reports presentation times, and has a
/// keyboard and a pointer.
pub const ON_X: [Screen; 3] =
    [("X11-1", [320, 240], [0, 0]), ("X11-2", [400, 300], [320, 0]), ("X11-3", [640, 360], [720, 0])];

/// Longest time that a test waits for a condition.
const PATIENCE: Duration = Duration::from_secs(60);

/// A running session.
pub struct Session {
    server: Child,
    folder: tempfile::TempDir,
    env: Vec<(&'static str, String)>,
    /// The outer session, whose windows are this session's outputs.
    outer: Option<Box<Session>>,
}

impl Drop for Session {
    fn drop(&mut self) {
        self.end();
    }
}

impl Session {
    /// Ends the server.
    pub fn end(&mut self) {
        if !matches!(self.server.try_wait(), Ok(None)) {
            return;
        }
        let _ = Command::new("kill").arg(self.server.id().to_string()).status();
        let end = Instant::now() + Duration::from_secs(3);
        while Instant::now() < end && matches!(self.server.try_wait(), Ok(None)) {
            std::thread::sleep(Duration::from_millis(20));
        }
        let _ = self.server.kill();
        let _ = self.server.wait();
    }
}

/// Returns true if `program`, which a session needs, is installed, and if the variable
/// `LUMISTACK_SESSIONS` permits sessions. Sessions disturb each other. So only the step `panels` of
/// `cargo xtask` sets the variable; this step runs the tests one after another.
fn has(program: &str) -> bool {
    if std::env::var_os("LUMISTACK_SESSIONS").is_none() {
        lumistack_testkit::skip::runs_in("panels");
        return false;
    }
    let found = std::env::var_os("PATH")
        .is_some_and(|path| std::env::split_paths(&path).any(|folder| folder.join(program).is_file()));
    if !found {
        lumistack_testkit::skip::skipped(&format!("no {program} (`cargo xtask ci` fetches it on Debian)"));
    }
    found
}

/// Waits until `look` returns a value. Panics after the time `PATIENCE`; `what` names the value.
pub fn wait_for<T>(what: &str, mut look: impl FnMut() -> Option<T>) -> T {
    let end = Instant::now() + PATIENCE;
    loop {
        if let Some(found) = look() {
            return found;
        }
        assert!(Instant::now() < end, "{what}: not within {PATIENCE:?}");
        std::thread::sleep(Duration::from_millis(30));
    }
}

fn is_root() -> bool {
    Command::new("id").arg("-u").output().is_ok_and(|output| output.stdout.trim_ascii() == b"0")
}

impl Session {
    /// Starts sway with headless outputs; `None` if `has` returns false for a program.
    pub fn sway(outputs: &[Screen]) -> Option<Self> {
        let backend = [("WLR_BACKENDS", "headless".into()), ("WLR_HEADLESS_OUTPUTS", outputs.len().to_string())];
        Self::start_sway(outputs, &backend, None)
    }

    /// Starts a sway with outputs that can be unplugged; see [`NESTED`].
    pub fn nested(outputs: &[Screen]) -> Option<Self> {
        let outer = Self::sway(&[("HEADLESS-1", [1600, 900], [0, 0])])?;
        // let windows float: if sway tiled them, it would change the size of the nested outputs
        assert!(outer.command("swaymsg").arg("for_window [app_id=\".*\"] floating enable").status().unwrap().success());
        // use an absolute path, since a relative path would refer to the nested session's folder
        let display = format!("{}/{}", outer.env("XDG_RUNTIME_DIR"), outer.env("WAYLAND_DISPLAY"));
        let backend = [
            ("WLR_BACKENDS", "wayland".into()),
            ("WLR_WL_OUTPUTS", outputs.len().to_string()),
            ("WAYLAND_DISPLAY", display),
        ];
        Self::start_sway(outputs, &backend, Some(outer))
    }

    /// Starts sway on an X server; see [`ON_X`].
    pub fn sway_on_x(outputs: &[Screen]) -> Option<Self> {
        if !has("sway") {
            return None;
        }
        let outer = Self::xorg(&[("DUMMY0", [1600, 900], [0, 0])])?;
        let backend = [
            ("WLR_BACKENDS", "x11".into()),
            ("WLR_X11_OUTPUTS", outputs.len().to_string()),
            ("DISPLAY", outer.env("DISPLAY")),
        ];
        Self::start_sway(outputs, &backend, Some(outer))
    }

    fn start_sway(outputs: &[Screen], backend: &[(&str, String)], outer: Option<Self>) -> Option<Self> {
        if !has("sway") || !has("grim") {
            return None;
        }
        let folder = tempfile::Builder::new().prefix("lumistack-sway").tempdir().unwrap();
        let runtime = folder.path().to_owned();
        let mut config = String::from("default_border none\nfocus_follows_mouse no\n");
        for (name, [cols, rows], [x, y]) in outputs {
            config += &format!("output {name} resolution {cols}x{rows} position {x},{y}\n");
        }
        std::fs::write(runtime.join("config"), config).unwrap();
        let mut server = if is_root() {
            // sway refuses to run as root, so it runs as another user; its clients may run as root
            assert!(Command::new("chown").args(["-R", "nobody"]).arg(&runtime).status().unwrap().success());
            let mut drop_rights = Command::new("setpriv");
            drop_rights.args(["--reuid=nobody", "--regid=nogroup", "--clear-groups", "--", "sway"]);
            drop_rights
        } else {
            Command::new("sway")
        };
        Command::new("chmod").arg("700").arg(&runtime).status().unwrap();
        server.arg("-c").arg(runtime.join("config"));
        server.env_remove("DISPLAY").env_remove("WAYLAND_DISPLAY");
        server.envs([("WLR_LIBINPUT_NO_DEVICES", "1"), ("WLR_RENDERER", "pixman")]);
        server.envs(backend.iter().map(|(key, value)| (key, value))).env("XDG_RUNTIME_DIR", &runtime);
        let server = server.stdout(Stdio::null()).stderr(Stdio::null()).spawn().unwrap();
        let named = |prefix: &str, end: &str| -> Option<PathBuf> {
            let entries = std::fs::read_dir(&runtime).ok()?.flatten();
            entries.map(|entry| entry.path()).find(|path| {
                let name = path.file_name().unwrap_or_default().to_string_lossy().into_owned();
                name.starts_with(prefix) && name.ends_with(end) && !name.ends_with(".lock")
            })
        };
        let mut session = Self { server, folder, env: Vec::new(), outer: outer.map(Box::new) };
        let control = wait_for("sway's control socket", || named("sway-ipc.", ".sock"));
        let display = wait_for("sway's display", || named("wayland-", ""));
        session.env = vec![
            ("XDG_RUNTIME_DIR", runtime.display().to_string()),
            ("WAYLAND_DISPLAY", display.file_name().unwrap().to_string_lossy().into_owned()),
            ("SWAYSOCK", control.display().to_string()),
            ("XDG_SESSION_TYPE", "wayland".into()),
        ];
        wait_for("sway's outputs", || {
            let listed = session.command("swaymsg").args(["-t", "get_outputs", "-r"]).output().ok()?;
            let text = String::from_utf8_lossy(&listed.stdout).into_owned();
            outputs.iter().all(|(name, ..)| text.contains(name)).then_some(())
        });
        Some(session)
    }

    /// Unplugs an output of a nested sway permanently, by closing the window that shows it.
    pub fn unplug(&self, output: &str) {
        let window = format!("[title=\"{output}$\"] kill");
        assert!(self.outer().command("swaymsg").arg(window).status().unwrap().success());
    }

    /// Returns the outer session.
    pub fn outer(&self) -> &Self {
        self.outer.as_ref().expect("a nested session")
    }

    /// Returns the number of an X server's display.
    pub fn x_display(&self) -> u32 {
        self.env("DISPLAY").trim_start_matches(':').parse().unwrap()
    }

    fn env(&self, key: &str) -> String {
        self.env.iter().find(|(name, _)| *name == key).expect("part of every session").1.clone()
    }

    /// Starts Xorg with the dummy driver; `None` if `has` returns false for a program, or if the
    /// user is not root.
    pub fn xorg(outputs: &[Screen]) -> Option<Self> {
        if !has("Xorg") || !has("xrandr") || !has("import") {
            return None;
        }
        if !is_root() {
            lumistack_testkit::skip::skipped("Xorg's dummy driver needs root");
            return None;
        }
        let folder = tempfile::Builder::new().prefix("lumistack-xorg").tempdir().unwrap();
        let config = "\
Section \"ServerFlags\"\nOption \"AutoAddDevices\" \"false\"\nEndSection\n\
Section \"Device\"\nIdentifier \"d\"\nDriver \"dummy\"\nVideoRam 256000\nEndSection\n\
Section \"Monitor\"\nIdentifier \"m\"\nHorizSync 5.0-1000.0\nVertRefresh 5.0-200.0\nEndSection\n\
Section \"Screen\"\nIdentifier \"s\"\nDevice \"d\"\nMonitor \"m\"\nDefaultDepth 24\nSubSection \"Display\"\nDepth 24\nVirtual 3840 2160\nEndSubSection\nEndSection\n";
        std::fs::write(folder.path().join("xorg.conf"), config).unwrap();
        // the server chooses a free display number and writes it to its standard output (1), a pipe
        let mut server = Command::new("Xorg");
        server
            .args(["-displayfd", "1", "-noreset", "-nolisten", "tcp", "-config"])
            .arg(folder.path().join("xorg.conf"));
        server.arg("-logfile").arg(folder.path().join("xorg.log")).stdout(Stdio::piped()).stderr(Stdio::null());
        let mut server = server.spawn().unwrap();
        let mut number = String::new();
        let stdout = server.stdout.take().unwrap();
        std::io::BufRead::read_line(&mut std::io::BufReader::new(stdout), &mut number).unwrap();
        let env = vec![
            ("DISPLAY", format!(":{}", number.trim())),
            ("XDG_RUNTIME_DIR", folder.path().display().to_string()),
            ("XDG_SESSION_TYPE", "x11".into()),
        ];
        let session = Self { server, folder, env, outer: None };
        for (name, [cols, rows], [x, y]) in outputs {
            let mode = format!("{cols}x{rows}p");
            let (total_x, total_y) = (cols + 80, rows + 20);
            // this pixel clock, in MHz, gives about 60 Hz
            let clock = format!("{:.3}", total_x as f64 * total_y as f64 * 60.0 / 1e6);
            let timing = [cols + 8, cols + 40, total_x, *rows, rows + 3, rows + 7, total_y].map(|n| n.to_string());
            let mut new = session.command("xrandr");
            new.args(["--newmode", &mode, &clock, &cols.to_string()]).args(timing);
            assert!(new.status().unwrap().success());
            assert!(session.command("xrandr").args(["--addmode", name, &mode]).status().unwrap().success());
            let place = format!("{x}x{y}");
            let on = session.command("xrandr").args(["--output", name, "--mode", &mode, "--pos", &place]).status();
            assert!(on.unwrap().success());
        }
        Some(session)
    }

    /// Returns the command of a program that runs in this session.
    pub fn command(&self, program: &str) -> Command {
        let mut command = Command::new(program);
        command.env_remove("DISPLAY").env_remove("WAYLAND_DISPLAY").env_remove("SWAYSOCK");
        command.envs(self.env.iter().map(|(key, value)| (key, value)));
        command
    }

    /// Takes a screenshot of an output of sway: [columns, rows] and `[row][col][rgb]`.
    pub fn grim(&self, output: &str) -> Option<Picture> {
        let shot = self.command("grim").args(["-t", "ppm", "-o", output, "-"]).output().ok()?;
        Picture::from_ppm(&shot.stdout)
    }

    /// Takes a screenshot of all outputs of sway.
    pub fn grim_all(&self) -> Option<Picture> {
        Picture::from_ppm(&self.command("grim").args(["-t", "ppm", "-"]).output().ok()?.stdout)
    }

    /// Takes a screenshot of all outputs of an X server.
    pub fn import(&self) -> Option<Picture> {
        let shot = self.command("import").args(["-silent", "-window", "root", "-depth", "8", "ppm:-"]).output().ok()?;
        Picture::from_ppm(&shot.stdout)
    }
}

/// A picture of a screen.
#[derive(Clone, Debug, PartialEq)]
pub struct Picture {
    pub size: [usize; 2],
    pub rgb: Vec<u8>,
}

impl Picture {
    /// Parses a binary PPM of 8 bits.
    fn from_ppm(bytes: &[u8]) -> Option<Self> {
        let mut numbers = Vec::new();
        let mut at = bytes.strip_prefix(b"P6").map(|_| 2)?;
        while numbers.len() < 3 {
            at += bytes[at..].iter().position(u8::is_ascii_digit)?;
            let end = at + bytes[at..].iter().position(|byte| !byte.is_ascii_digit())?;
            numbers.push(std::str::from_utf8(&bytes[at..end]).ok()?.parse::<usize>().ok()?);
            at = end;
        }
        let rgb = bytes[at + 1..].to_vec();
        let size = [numbers[0], numbers[1]];
        (numbers[2] == 255 && rgb.len() == 3 * size[0] * size[1]).then_some(Self { size, rgb })
    }

    /// Returns a rectangle of the picture.
    pub fn part(&self, [x, y]: [i32; 2], [cols, rows]: [usize; 2]) -> Self {
        let lines = (y as usize..y as usize + rows).flat_map(|row| {
            let start = 3 * (row * self.size[0] + x as usize);
            self.rgb[start..start + 3 * cols].iter().copied()
        });
        Self { size: [cols, rows], rgb: lines.collect() }
    }

    /// Saves the picture to a file, for a developer.
    pub fn save(&self, path: &std::path::Path) {
        let image = image::RgbImage::from_raw(self.size[0] as u32, self.size[1] as u32, self.rgb.clone()).unwrap();
        image.save(path).unwrap();
    }
}
