//! Clean copies of Debian stable in `target/install`, in which programs run with their own mounts
//! and processes.

use std::path::{Path, PathBuf};
use std::process::Command;

use crate::tools::{self, Outcome, command, output_of, run};

/// Returns the folder of the copies.
pub fn folder() -> PathBuf {
    tools::root().join("target/install")
}

/// Returns a command that runs a program in its own namespaces of mounts and processes. When the
/// program ends, the processes that it started end too.
fn apart() -> Command {
    let mut unshare = command("unshare");
    unshare.args(["--mount", "--pid", "--fork", "--kill-child"]);
    unshare
}

/// Returns the folder of an unused Debian stable; makes it at the first call.
pub fn clean() -> Outcome<PathBuf> {
    if output_of(command("id").arg("-u")).is_none_or(|id| id.trim() != "0") {
        return Err("a clean Debian can be made only by the user root".into());
    }
    if output_of(apart().arg("true")).is_none() {
        return Err("a clean Debian needs mounts, which this machine does not allow".into());
    }
    let base = folder().join("debian-stable");
    if base.join("usr/bin/apt-get").is_file() {
        return Ok(base);
    }
    if output_of(command("debootstrap").arg("--version")).is_none() {
        tools::apt(&["debootstrap"], "make a clean Debian")?;
    }
    let site = tools::debian_mirror()?;
    let part = folder().join("debian-part");
    let _ = std::fs::remove_dir_all(&part);
    run(command("debootstrap").args(["--variant=minbase", "stable"]).arg(&part).arg(site))?;
    run(command("sh").args(["-c", "cp -r /etc/apt/apt.conf.d/. \"$1/etc/apt/apt.conf.d/\"", "sh"]).arg(&part))?;
    std::fs::rename(&part, &base).map_err(|error| format!("{}: {error}", base.display()))?;
    Ok(base)
}

/// A copy of Debian that belongs to one test.
pub struct Copy(PathBuf);

impl Copy {
    /// Copies a Debian into the folder `name`. A folder of an earlier copy is replaced.
    pub fn of(base: &Path, name: &str) -> Outcome<Self> {
        let place = folder().join(name);
        let _ = std::fs::remove_dir_all(&place);
        run(command("cp").args(["-a", "--reflink=auto"]).arg(base).arg(&place))?;
        run(command("cp").arg("-L").arg("/etc/resolv.conf").arg(place.join("etc/resolv.conf")))?;
        // a machine behind a proxy has certificates of its own, with which pip must check sites
        if Path::new(CERTIFICATES[0]).is_file() {
            let inside = place.join(CERTIFICATES[1].trim_start_matches('/'));
            run(command("cp").arg("-L").arg(CERTIFICATES[0]).arg(inside))?;
        }
        Ok(Self(place))
    }

    /// Returns a copy that was made earlier. If there is none, makes a copy and runs `make` on it.
    /// A copy that `make` leaves unfinished is not used.
    pub fn kept(name: &str, make: impl FnOnce(&Self) -> Outcome) -> Outcome<Self> {
        let place = folder().join(name);
        if !place.is_dir() {
            let part = Self::of(&clean()?, &format!("{name}-part"))?;
            make(&part)?;
            std::fs::rename(&part.0, &place).map_err(|error| format!("{}: {error}", place.display()))?;
        }
        Ok(Self(place))
    }

    /// Returns the folder of the copy.
    pub fn place(&self) -> &Path {
        &self.0
    }

    /// Returns a command that runs a program in the copy, with an almost empty environment.
    /// `variables` are further variables, `NAME=VALUE`. `shared` are folders of this machine that
    /// are also in the copy, at the same paths.
    pub fn command(&self, shared: &[&Path], variables: &[&str]) -> Command {
        let mut command = apart();
        command.args(["sh", "-euc", ENTER, "sh"]).arg(&self.0);
        command.args(shared).arg("--");
        command.args(["/usr/bin/env", "-i", "HOME=/root", "LANG=C.UTF-8", "CLEAN=1"]).args(variables);
        if self.0.join(CERTIFICATES[1].trim_start_matches('/')).is_file() {
            command.arg(format!("PIP_CERT={}", CERTIFICATES[1]));
        }
        command.arg("PATH=/usr/local/sbin:/usr/local/bin:/usr/sbin:/usr/bin:/sbin:/bin");
        command
    }

    /// Removes the copy.
    pub fn remove(self) {
        let _ = std::fs::remove_dir_all(self.0);
    }
}

/// A shell script that mounts the file systems that programs expect and runs a program in a Debian:
/// `sh -c ENTER sh FOLDER SHARED... -- PROGRAM...`
const ENTER: &str = "place=$1; shift; \
     mount -t proc proc \"$place/proc\"; mkdir -p \"$place/dev/shm\" \"$place/dev/pts\"; \
     mount -t tmpfs tmpfs \"$place/dev/shm\"; mount -t devpts devpts \"$place/dev/pts\"; \
     while [ \"$1\" != -- ]; do mkdir -p \"$place$1\"; mount --bind \"$1\" \"$place$1\"; shift; done; shift; \
     exec chroot \"$place\" \"$@\"";

/// Debian's file of certificates, and its name in the copy, where packages do not replace it.
const CERTIFICATES: [&str; 2] = ["/etc/ssl/certs/ca-certificates.crt", "/certificates.crt"];
