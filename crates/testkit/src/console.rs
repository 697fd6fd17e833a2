//! Ctrl-C for programs that tests start, and, on Windows, the text that they write to a console.
//!
//! Windows signals all programs of a console, and a program can only signal its own console. So a
//! program that will be interrupted gets its own console, without a window. Then a second process
//! of the test's program joins this console, and sends the signal there. The second process runs
//! only the test `common::helps`, which calls `help`.

use std::process::{Child, Command};

/// Gives the program its own process group (on Windows its own console). So [`interrupt`] signals
/// this program and the programs that it starts, but not the test.
pub fn interruptible(command: &mut Command) -> &mut Command {
    #[cfg(unix)]
    std::os::unix::process::CommandExt::process_group(command, 0);
    #[cfg(windows)]
    std::os::windows::process::CommandExt::creation_flags(command, windows::CREATE_NO_WINDOW);
    command
}

/// Sends Ctrl-C to a program and to the programs that it has started, as a terminal does. The
/// program was started by a command of [`interruptible`].
pub fn interrupt(child: &Child) {
    #[cfg(unix)]
    let status = Command::new("kill").args(["-INT", "--", &format!("-{}", child.id())]).status();
    #[cfg(windows)]
    let status = windows::helper(windows::INTERRUPT, &[child.id().to_string()]).status();
    assert!(status.expect("the test starts programs").success(), "process {} cannot be interrupted", child.id());
}

#[cfg(windows)]
pub use windows::{Screen, help, screen_of};

#[cfg(windows)]
mod windows {
    use std::fs::File;
    use std::os::windows::io::AsRawHandle;
    use std::os::windows::process::CommandExt;
    use std::process::Command;
    use std::time::Duration;

    use windows_sys::Win32::System::Console::{
        ATTACH_PARENT_PROCESS, AttachConsole, CONSOLE_SCREEN_BUFFER_INFO, COORD, CTRL_C_EVENT,
        ENABLE_VIRTUAL_TERMINAL_PROCESSING, FreeConsole, GenerateConsoleCtrlEvent, GetConsoleMode,
        GetConsoleScreenBufferInfo, ReadConsoleOutputCharacterW, SetConsoleCtrlHandler, SetConsoleScreenBufferSize,
    };
    pub(super) use windows_sys::Win32::System::Threading::CREATE_NO_WINDOW;

    /// Environment variables of the second process, with the words of its task.
    pub(super) const INTERRUPT: &str = "LUMISTACK_TEST_INTERRUPTS";
    const SHOW: &str = "LUMISTACK_TEST_SHOWS";
    /// Separates words, and lines. No word and no line contains it.
    const SEPARATOR: &str = "\u{1f}";
    /// Size of a console's screen, columns and rows. No line of the tested programs is wider.
    const SCREEN: COORD = COORD { X: 400, Y: 300 };

    /// Returns a command that runs [`help`] in a second process of this test's program.
    pub(super) fn helper(task: &str, words: &[String]) -> Command {
        let mut command = Command::new(std::env::current_exe().expect("this program has a path"));
        command.args(["--exact", "common::helps", "--nocapture"]).env(task, words.join(SEPARATOR));
        command
    }

    /// The screen of a console.
    #[derive(Debug)]
    pub struct Screen {
        /// The lines, up to the cursor.
        pub lines: Vec<String>,
        /// True if the console is in the mode in which it interprets control sequences. Wine 10 has
        /// this mode, but shows the sequences.
        pub interprets: bool,
    }

    /// Runs a program in its own console, and returns the console's screen.
    pub fn screen_of(program: &str, words: &[&str]) -> Screen {
        let words: Vec<String> = [&[program], words].concat().into_iter().map(str::to_owned).collect();
        let output = helper(SHOW, &words).creation_flags(CREATE_NO_WINDOW).output().expect("the test starts itself");
        let text = String::from_utf8(output.stdout).expect("the helper writes UTF-8");
        assert!(output.status.success(), "{text}{}", String::from_utf8_lossy(&output.stderr));
        // before the first and after the last separator are the prints of the test program
        let lines: Vec<String> = text.split(SEPARATOR).map(|line| line.trim_end().to_owned()).collect();
        let [_, interprets, lines @ .., _] = lines.as_slice() else { panic!("{text}") };
        Screen { lines: lines.to_vec(), interprets: interprets == "true" }
    }

    /// In a second process of a test's program, does the task that the environment names. In other
    /// processes, does nothing.
    pub fn help() {
        let words = |task| Some(std::env::var(task).ok()?.split(SEPARATOR).map(str::to_owned).collect::<Vec<_>>());
        if let Some(words) = words(INTERRUPT) {
            send_ctrl_c(words[0].parse().expect("the id of a process"));
        }
        if let Some(words) = words(SHOW) {
            let Screen { lines, interprets } = show(&words);
            print!("{SEPARATOR}{interprets}{SEPARATOR}{}{SEPARATOR}", lines.join(SEPARATOR));
        }
    }

    fn done(result: i32) {
        assert!(result != 0, "{}", std::io::Error::last_os_error());
    }

    unsafe extern "system" fn stay(_event: u32) -> i32 {
        1
    }

    fn send_ctrl_c(process: u32) {
        // SAFETY: none of these functions has preconditions; `stay` lives as long as the process
        unsafe {
            // this call fails if the process has no console, which does no harm
            FreeConsole();
            done(AttachConsole(process));
            done(SetConsoleCtrlHandler(Some(stay), 1));
            done(GenerateConsoleCtrlEvent(CTRL_C_EVENT, 0));
        }
        // the signal arrives in other threads, in this process too
        std::thread::sleep(Duration::from_millis(300));
        // SAFETY: as above
        unsafe {
            FreeConsole();
            AttachConsole(ATTACH_PARENT_PROCESS);
        }
    }

    /// Runs a program in this process's console, and returns its screen.
    fn show(words: &[String]) -> Screen {
        let screen = File::options().read(true).write(true).open("CONOUT$").expect("the process has a console");
        let handle = screen.as_raw_handle();
        // SAFETY: the handle is open
        done(unsafe { SetConsoleScreenBufferSize(handle, SCREEN) });
        let writer = || screen.try_clone().expect("handles can be copied");
        let status = Command::new(&words[0]).args(&words[1..]).stdout(writer()).stderr(writer()).status();
        assert!(status.expect("the program starts").success());
        let (mut info, mut mode) = (CONSOLE_SCREEN_BUFFER_INFO::default(), 0);
        // SAFETY: the handle is open, and the functions write only `info` and `mode`
        unsafe {
            done(GetConsoleScreenBufferInfo(handle, &mut info));
            done(GetConsoleMode(handle, &mut mode));
        }
        let line = |row: i16| {
            let mut units = vec![0; SCREEN.X as usize];
            let mut count = 0;
            // SAFETY: the handle is open, and the function writes at most `units.len()` units
            done(unsafe {
                let start = COORD { X: 0, Y: row };
                ReadConsoleOutputCharacterW(handle, units.as_mut_ptr(), units.len() as u32, start, &mut count)
            });
            String::from_utf16_lossy(&units[..count as usize])
        };
        let lines = (0..=info.dwCursorPosition.Y).map(line).collect();
        Screen { lines, interprets: mode & ENABLE_VIRTUAL_TERMINAL_PROCESSING != 0 }
    }
}
