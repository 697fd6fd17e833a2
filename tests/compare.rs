//! `compare` on the command line: the displays of one run side by side, and a photograph of panels
//! with its simulation.

use std::path::{Path, PathBuf};

use lumistack_core::colour::srgb_code;
use lumistack_core::seed::Stream;
use lumistack_field_io::picture::Picture;
use serde_json::Value;

use crate::common::{fail, lumistack, report, succeed};

/// Makes a run of two displays, with cards in front of and behind the display plane.
fn run_of_two(folder: &Path) -> PathBuf {
    let (job, out) = (folder.join("two.toml"), folder.join("two"));
    let text = "outputs = []\n[source]\nplugin = \"test_views\"\nparams = { pattern = \"cards\", depth_mm = 60.0 }\n\n[display]\npreset = \"fig7-uniform\"\nresolution = [64, 40]\n\n\
        [factorize]\niterations = 30\n\n[[nodes]]\nid = \"three-layers\"\n\n[[nodes]]\nid = \"static\"\n[nodes.display]\npreset = \"fig7-uniform\"\nframes = 1\n";
    std::fs::write(&job, text).unwrap();
    succeed(lumistack().arg("run").arg(&job).arg("-o").arg(&out));
    out
}

fn done(text: &str) -> Value {
    text.lines().filter_map(|line| serde_json::from_str(line).ok()).find(|e: &Value| e["event"] == "done").unwrap()
}

/// A pinhole camera, in display space, millimetres.
struct Camera {
    eye: [f64; 3],
    /// Unit vectors to the right, up and forward.
    axes: [[f64; 3]; 3],
    size: [usize; 2],
    focal_px: f64,
}

impl Camera {
    /// Returns a camera that looks at the point `at` of the display plane. The camera is rotated a
    /// little about its viewing direction.
    fn looking(eye: [f64; 3], at: [f64; 2]) -> Self {
        let cross = |a: [f64; 3], b: [f64; 3]| {
            [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]
        };
        let unit = |v: [f64; 3]| v.map(|x| x / v.iter().map(|x| x * x).sum::<f64>().sqrt());
        let forward = unit([at[0] - eye[0], at[1] - eye[1], -eye[2]]);
        let right = unit(cross(forward, [0.04, 1.0, 0.0]));
        Self { eye, axes: [right, cross(right, forward), forward], size: [900, 675], focal_px: 1000.0 }
    }

    /// Returns the pixel at which the camera sees a point of the display plane.
    fn pixel_of(&self, [x, y]: [f64; 2]) -> [f64; 2] {
        let seen = [x - self.eye[0], y - self.eye[1], -self.eye[2]];
        let [right, up, forward] = self.axes.map(|axis| axis.iter().zip(seen).map(|(a, b)| a * b).sum::<f64>());
        let [width, height] = self.size.map(|side| side as f64);
        [0.5 * width + self.focal_px * right / forward, 0.5 * height - self.focal_px * up / forward]
    }

    /// Returns the point of the display plane that the camera sees at a pixel.
    fn point_at(&self, [x, y]: [f64; 2]) -> [f64; 2] {
        let [width, height] = self.size.map(|side| side as f64);
        let (right, up) = ((x - 0.5 * width) / self.focal_px, (0.5 * height - y) / self.focal_px);
        let ray = [0, 1, 2].map(|i| self.axes[2][i] + right * self.axes[0][i] + up * self.axes[1][i]);
        let t = -self.eye[2] / ray[2];
        [self.eye[0] + t * ray[0], self.eye[1] + t * ray[1]]
    }

    /// Renders a photograph of a display that emits `shown` `[row][col][rgb]` towards the camera.
    /// The display is in a dim room. The light is multiplied by `exposure`, and gets noise and
    /// 8-bit codes.
    fn photograph(&self, shown: &[f32], [cols, rows]: [usize; 2], pitch_mm: f64, exposure: f64, path: &Path) {
        // standard deviation of the noise of a camera at low sensitivity
        const NOISE: f64 = 0.01;
        // light of the room around the display
        const ROOM: f64 = 0.03;
        let mut stream = Stream::new(11);
        let mut codes = Vec::new();
        for (py, px) in (0..self.size[1]).flat_map(|y| (0..self.size[0]).map(move |x| (y, x))) {
            let mut light = [0.0; 3];
            for (dy, dx) in [(0.25, 0.25), (0.25, 0.75), (0.75, 0.25), (0.75, 0.75)] {
                let [x, y] = self.point_at([px as f64 + dx, py as f64 + dy]);
                let (col, row) = (x / pitch_mm + 0.5 * cols as f64, 0.5 * rows as f64 - y / pitch_mm);
                let inside = (0.0..cols as f64).contains(&col) && (0.0..rows as f64).contains(&row);
                let at = 3 * (row.max(0.0) as usize * cols + col.max(0.0) as usize);
                (0..3).for_each(|c| light[c] += 0.25 * if inside { f64::from(shown[at + c]) } else { ROOM });
            }
            for value in light {
                // the sum of twelve uniform numbers, minus 6, is nearly normal with mean 0,
                // variance 1
                let noise = NOISE * ((0..12).map(|_| f64::from(stream.next_f32())).sum::<f64>() - 6.0);
                codes.push(srgb_code((exposure * value + noise) as f32));
            }
        }
        let [width, height] = self.size.map(|side| side as u32);
        image::RgbImage::from_raw(width, height, codes).unwrap().save(path).unwrap();
    }
}

/// A photograph is compared with the simulation from three poses of the camera. The two agree for
/// the known pose and for the pose that is computed from the corners, but not for a wrong pose.
#[test]
fn a_photograph_is_compared_at_its_pose_and_exposure() {
    const EXPOSURE: f64 = 0.6;
    let folder = tempfile::tempdir().unwrap();
    let run = run_of_two(folder.path()).join("nodes/three-layers");
    let eye = [150.0, 60.0, 900.0];
    let point = |eye: [f64; 3]| eye.map(|x| x.to_string()).join(",");
    let simulated = folder.path().join("simulated.exr");
    succeed(lumistack().arg("simulate").arg(&run).args(["--eye", &point(eye), "-o"]).arg(&simulated));
    let picture = Picture::read(&simulated).unwrap();
    let (size, shown) = (picture.size(), picture.into_linear());
    assert_eq!(size, [64, 40]);
    // the preset has 160 pixels of 2.961 mm, which are reduced to 64
    let pitch = 160.0 * 2.961 / 64.0;
    let camera = Camera::looking(eye, [20.0, -10.0]);
    let photo = folder.path().join("photo.png");
    camera.photograph(&shown, size, pitch, EXPOSURE, &photo);
    let half = [32.0 * pitch, 20.0 * pitch];
    let corners = [[-1.0, 1.0], [1.0, 1.0], [1.0, -1.0], [-1.0, -1.0]];
    let corners =
        corners.map(|[x, y]| camera.pixel_of([x * half[0], y * half[1]]).map(|v| format!("{v:.1}")).join(","));
    let corners = corners.join(",");
    let compared = |pose: &[&str]| {
        let mut command = lumistack();
        command.args(["--json", "compare"]).arg(&run).arg(&photo).args(["--corners", &corners]).args(pose);
        done(&succeed(command.arg("-o").arg(folder.path().join("compared"))))["photograph"].clone()
    };
    let psnr = |found: &Value| found["likeness"]["psnr_db"].as_f64().unwrap();
    let known = compared(&["--eye", &point(eye)]);
    let gain = known["gain"].as_f64().unwrap();
    assert!((gain * EXPOSURE - 1.0).abs() < 0.01, "the photograph has {EXPOSURE} of the light: {known}");
    assert!(psnr(&known) > 30.0 && known["clipped"] == 0.0, "{known}");
    let sheet = image::open(folder.path().join("compared/photograph.png")).unwrap();
    assert_eq!((sheet.width(), sheet.height()), (3 * 64, 40), "simulation, photograph, difference");

    let diagonal = 900f64.hypot(675.0);
    let focal = format!("{:.3}", 1000.0 / diagonal * 36f64.hypot(24.0));
    let found = compared(&["--focal-35mm", &focal]);
    for (found, expected) in found["eye_mm"].as_array().unwrap().iter().zip(eye) {
        assert!(
            (found.as_f64().unwrap() - expected).abs() < 3.0,
            "position from corners that are rounded to a tenth of a pixel: {found}, expected {expected}"
        );
    }
    // The computed position differs slightly from the true position. Some rays then hit the next
    // pixel of a layer, so the pictures differ a little.
    assert!(psnr(&found) > 30.0, "{found}");

    let elsewhere = compared(&["--eye", &point([-150.0, 60.0, 900.0])]);
    assert!(psnr(&elsewhere) < psnr(&known) - 5.0, "{elsewhere}");

    // with a longer exposure some pixels are clipped, and the comparison excludes these pixels
    camera.photograph(&shown, size, pitch, 2.0, &photo);
    let bright = compared(&["--eye", &point(eye)]);
    assert!(bright["clipped"].as_f64().unwrap() > 0.02, "{bright}");
    assert!((bright["gain"].as_f64().unwrap() * 2.0 - 1.0).abs() < 0.02 && psnr(&bright) > 30.0, "{bright}");
    let text = fail(lumistack().arg("compare").arg(&run).arg(&photo).args(["--corners", "0,0,9,9,0,9,9,0"]));
    assert!(text.contains("four corners of a convex figure"), "{text}");
}

#[test]
fn all_displays_of_a_run_stand_side_by_side() {
    let folder = tempfile::tempdir().unwrap();
    let run = run_of_two(folder.path());
    let out = folder.path().join("compared");
    let found = done(&succeed(lumistack().args(["--json", "compare"]).arg(&run).arg("-o").arg(&out)));
    let displays = found["run"]["displays"].as_array().unwrap();
    assert_eq!(displays.len(), 2);
    for display in displays {
        let id = display["id"].as_str().unwrap();
        let own = report(&run.join("nodes").join(id))["psnr_view"].as_f64().unwrap();
        assert!((display["likeness"]["psnr_db"].as_f64().unwrap() - own).abs() < 0.01, "{display}, report {own}");
    }
    // The sheet has a column for the target and for each of two displays. Each column has three
    // views. A view of 64 × 40 pixels is enlarged four times.
    let sheet = image::open(out.join("displays.jpg")).unwrap();
    assert!(sheet.width() > 3 * 4 * 64 && sheet.height() > 3 * 4 * 40, "{} × {}", sheet.width(), sheet.height());
    let printed = succeed(lumistack().arg("compare").arg(&run));
    assert!(printed.contains("three-layers") && printed.contains("1 frame, β = 0.20"), "{printed}");
    let pictures = ["--focus", "0", "-o", "pictures"];
    let text = fail(lumistack().current_dir(folder.path()).arg("compare").arg(&run).args(pictures));
    assert!(text.contains("--focus") && text.contains("expected two run folders"), "{text}");
    assert!(!folder.path().join("pictures").exists());
    let text = fail(lumistack().arg("compare").arg(run.join("nodes/static")));
    assert!(text.contains("job.toml"), "{text}");
}
