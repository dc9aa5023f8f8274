//! The real programs: built once with the profile of the tests, started, listened to, and stopped.
//!
//! `cargo test` builds no program of another package by itself, so the first test that needs one asks
//! cargo for all of them. A [`Program`] never outlives the test that started it.

use std::io::{BufRead, BufReader, Read, Write};
use std::net::SocketAddr;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, ExitStatus, Stdio};
use std::sync::{Arc, Condvar, Mutex, MutexGuard, OnceLock, PoisonError};
use std::time::{Duration, Instant};

use anyhow::{Context, Result, anyhow, bail};

/// Long enough for anything that a test waits for, a whole script of a peer among it, on a slow and busy
/// machine; reached only by a failure.
pub const PATIENCE: Duration = Duration::from_secs(300);

/// The folder of this profile's artefacts, such as `target/release`: the running test lies in its
/// `deps`.
///
/// # Errors
/// The test does not lie in a folder of cargo's.
pub fn profile_folder() -> Result<PathBuf> {
    let test = std::env::current_exe().context("finding the running test")?;
    let folder = test.ancestors().nth(2).context("the running test lies in no target folder")?;
    Ok(folder.to_path_buf())
}

/// The program `name` (`sitl`, `gcs` or `model`), after a build if one is due. The build takes place
/// once per test process, and cargo itself keeps processes apart.
///
/// # Errors
/// The programs cannot be built.
pub fn path(name: &str) -> Result<PathBuf> {
    static BUILT: OnceLock<std::result::Result<PathBuf, String>> = OnceLock::new();
    let folder =
        BUILT.get_or_init(|| build().map_err(|e| format!("{e:#}"))).clone().map_err(|e| anyhow!(e))?;
    let program = folder.join(format!("{name}{}", std::env::consts::EXE_SUFFIX));
    if !program.is_file() {
        bail!("cargo built no program {name} in {}", folder.display());
    }
    Ok(program)
}

/// Builds every program of the workspace and returns their folder.
fn build() -> Result<PathBuf> {
    let folder = profile_folder()?;
    let target = folder.parent().context("the profile's folder has no parent")?;
    let profile = match folder.file_name().and_then(|name| name.to_str()) {
        Some("debug") => "dev",
        Some(other) => other,
        None => bail!("no profile in {}", folder.display()),
    };
    let cargo = std::env::var_os("CARGO").unwrap_or_else(|| "cargo".into());
    // With the tests among the targets, cargo resolves the same features as `cargo test` did, and
    // nothing is compiled a second time.
    let output = Command::new(cargo)
        .args(["build", "--workspace", "--bins", "--tests", "--quiet", "--offline", "--profile", profile])
        .args(cfg!(feature = "ndarray").then_some("--features=tests/ndarray"))
        .arg("--target-dir")
        .arg(target)
        .current_dir(workspace())
        .stdin(Stdio::null())
        .output()
        .context("starting cargo")?;
    if !output.status.success() {
        bail!("building the programs failed:\n{}", String::from_utf8_lossy(&output.stderr));
    }
    Ok(folder)
}

/// Runs a command to its end.
///
/// # Errors
/// It cannot be started or ends badly: all that it printed.
pub fn checked(command: &mut Command) -> Result<()> {
    let output = command.output().with_context(|| format!("starting {command:?}"))?;
    if !output.status.success() {
        let (out, err) = (String::from_utf8_lossy(&output.stdout), String::from_utf8_lossy(&output.stderr));
        bail!("{command:?} ended with {}\n{out}{err}", output.status);
    }
    Ok(())
}

/// The root of the workspace.
#[must_use]
pub fn workspace() -> &'static Path {
    let package = Path::new(env!("CARGO_MANIFEST_DIR"));
    package.parent().unwrap_or(package)
}

/// What a program left behind.
#[derive(Debug)]
pub struct Finished {
    /// How it ended.
    pub status: ExitStatus,
    /// All that it printed.
    pub stdout: String,
    /// All that it logged.
    pub stderr: String,
}

impl Finished {
    /// What was printed, if the program ended well; an error with all that it logged if not.
    ///
    /// # Errors
    /// The program ended badly: all that it printed and logged.
    pub fn good(self) -> Result<String> {
        if !self.status.success() {
            bail!("ended with {}\nstdout:\n{}\nstderr:\n{}", self.status, self.stdout, self.stderr);
        }
        Ok(self.stdout)
    }
}

/// A started program. Dropping it kills it.
#[derive(Debug)]
pub struct Program {
    name: String,
    child: Child,
    /// Lines of stdout that a conversation has passed.
    heard: usize,
    stdout: Arc<Heard>,
    stderr: Arc<Heard>,
}

impl Program {
    /// Starts a program of the workspace in `folder`, or in the workspace's root.
    ///
    /// It finds no cache of policies unless it makes one.
    ///
    /// # Errors
    /// The programs cannot be built or started.
    pub fn start<A: AsRef<std::ffi::OsStr>>(name: &str, args: &[A], folder: Option<&Path>) -> Result<Self> {
        let mut command = Command::new(path(name)?);
        command.args(args).current_dir(folder.unwrap_or_else(|| workspace()));
        command.env("CRPL_CACHE", profile_folder()?.join("no-policies"));
        Self::spawn(name, command)
    }

    /// Starts any command with its output caught.
    ///
    /// # Errors
    /// It cannot be started.
    pub fn spawn(name: &str, command: Command) -> Result<Self> {
        Self::launch(name, command, Stdio::null())
    }

    /// Starts a command that reads what it is told ([`Program::tell`]).
    ///
    /// # Errors
    /// It cannot be started.
    pub fn converse(name: &str, command: Command) -> Result<Self> {
        Self::launch(name, command, Stdio::piped())
    }

    fn launch(name: &str, mut command: Command, stdin: Stdio) -> Result<Self> {
        let mut child = command
            .stdin(stdin)
            .stdout(Stdio::piped())
            .stderr(Stdio::piped())
            .spawn()
            .with_context(|| format!("starting {name}"))?;
        let stdout = Heard::listen(child.stdout.take().context("stdout is piped")?);
        let stderr = Heard::listen(child.stderr.take().context("stderr is piped")?);
        Ok(Self { name: name.into(), child, heard: 0, stdout, stderr })
    }

    /// The first printed line that starts with `prefix`, without it.
    ///
    /// # Errors
    /// It prints no such line in time.
    pub fn line(&self, prefix: &str) -> Result<String> {
        let found = self.stdout.wait(|lines| {
            lines.iter().find_map(|line| line.strip_prefix(prefix)).map(|rest| rest.trim().to_owned())
        });
        found.with_context(|| self.complaint(&format!("printed no line `{prefix}...`")))
    }

    /// Waits until something logged contains `text`.
    ///
    /// # Errors
    /// It logs no such line in time.
    pub fn logs(&self, text: &str) -> Result<()> {
        let found = self.stderr.wait(|lines| lines.iter().any(|line| line.contains(text)).then_some(()));
        found.with_context(|| self.complaint(&format!("did not log `{text}`")))
    }

    /// Writes a line to the program's stdin.
    ///
    /// # Errors
    /// It does not listen.
    pub fn tell(&mut self, line: &str) -> Result<()> {
        let stdin = self.child.stdin.as_mut().with_context(|| format!("{} does not listen", self.name))?;
        writeln!(stdin, "{line}").with_context(|| format!("telling {} `{line}`", self.name))
    }

    /// Waits until something printed since the last [`Program::hears`] contains `text`.
    ///
    /// # Errors
    /// It prints no such line in time.
    pub fn hears(&mut self, text: &str) -> Result<String> {
        let from = self.heard;
        let found = self.stdout.wait(|lines| {
            let at = lines.iter().skip(from).position(|line| line.contains(text))?;
            Some((from + at, lines[from + at].clone()))
        });
        let (at, line) =
            found.with_context(|| self.complaint(&format!("did not go on to print `{text}`")))?;
        self.heard = at + 1;
        Ok(line)
    }

    fn complaint(&self, what: &str) -> String {
        let (stdout, stderr) = (self.stdout.text(), self.stderr.text());
        format!("{} {what}\nstdout:\n{stdout}\nstderr:\n{stderr}", self.name)
    }

    /// All that it has printed and logged so far.
    #[must_use]
    pub fn so_far(&self) -> String {
        self.stdout.text() + "\n" + &self.stderr.text()
    }

    /// Closes the program's stdin, which ends one that converses.
    pub fn hang_up(&mut self) {
        drop(self.child.stdin.take());
    }

    /// Asks the program to end, as Ctrl-C does.
    ///
    /// # Errors
    /// There is no `kill`, or it fails.
    pub fn interrupt(&self) -> Result<()> {
        self.signal("-INT")
    }

    /// Sends a signal by its name, `-STOP` or `-CONT` for one.
    ///
    /// # Errors
    /// There is no `kill`, or it fails.
    pub fn signal(&self, name: &str) -> Result<()> {
        let kill = Command::new("kill").arg(name).arg(self.child.id().to_string()).status();
        let status = kill.context("starting kill")?;
        if !status.success() {
            bail!("kill {name} {}: ended with {status}", self.name);
        }
        Ok(())
    }

    /// Waits for the program's own end.
    ///
    /// # Errors
    /// It does not end in time.
    pub fn wait(mut self) -> Result<Finished> {
        let deadline = Instant::now() + PATIENCE;
        let status = loop {
            if let Some(status) =
                self.child.try_wait().with_context(|| format!("waiting for {}", self.name))?
            {
                break status;
            }
            if Instant::now() > deadline {
                let (stdout, stderr) = (self.stdout.text(), self.stderr.text());
                bail!("{} does not end\nstdout:\n{stdout}\nstderr:\n{stderr}", self.name);
            }
            std::thread::sleep(Duration::from_millis(5));
        };
        self.stdout.to_the_end();
        self.stderr.to_the_end();
        Ok(Finished { status, stdout: self.stdout.text(), stderr: self.stderr.text() })
    }
}

impl Drop for Program {
    fn drop(&mut self) {
        // Both fail only for a program that has ended already.
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

/// Runs a program of the workspace to its end.
///
/// # Errors
/// It cannot be started, or does not end in time.
pub fn run<A: AsRef<std::ffi::OsStr>>(name: &str, args: &[A]) -> Result<Finished> {
    Program::start(name, args, None)?.wait()
}

/// Runs a program of the workspace to its end, with a cache of policies of its own.
///
/// # Errors
/// As [`Program::start`].
pub fn run_with_cache<A: AsRef<std::ffi::OsStr>>(name: &str, args: &[A], cache: &Path) -> Result<Finished> {
    let mut command = Command::new(path(name)?);
    command.args(args).current_dir(workspace()).env("CRPL_CACHE", cache);
    Program::spawn(name, command)?.wait()
}

/// Starts `sitl` on a port of the system's choice and returns it with its address. It flies in the paper's
/// Scenario 2, without gusts, unless `args` name another scenario.
///
/// # Errors
/// It does not start.
pub fn sitl(args: &[&str]) -> Result<(Program, SocketAddr)> {
    let calm: &[&str] = if args.contains(&"--scenario") { &[] } else { &["--scenario", "2"] };
    let args: Vec<&str> = ["--listen", "udpin:127.0.0.1:0"].iter().chain(calm).chain(args).copied().collect();
    let program = Program::start("sitl", &args, None)?;
    let address = program.line("listening on udpin:")?;
    let address = address.parse().with_context(|| format!("sitl listens on {address:?}"))?;
    Ok((program, address))
}

/// Lines that a thread reads from a pipe, so that the program at its other end never waits.
#[derive(Debug, Default)]
struct Heard {
    lines: Mutex<(Vec<String>, bool)>,
    news: Condvar,
}

impl Heard {
    fn listen(pipe: impl Read + Send + 'static) -> Arc<Self> {
        let heard = Arc::new(Self::default());
        let ear = Arc::clone(&heard);
        std::thread::spawn(move || {
            let mut reader = BufReader::new(pipe);
            let mut bytes = Vec::new();
            while reader.read_until(b'\n', &mut bytes).is_ok_and(|n| n > 0) {
                ear.lock().0.push(String::from_utf8_lossy(&bytes).trim_end().to_owned());
                ear.news.notify_all();
                bytes.clear();
            }
            ear.lock().1 = true;
            ear.news.notify_all();
        });
        heard
    }

    fn lock(&self) -> MutexGuard<'_, (Vec<String>, bool)> {
        self.lines.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Waits until `look` finds something, the pipe ends or patience does.
    fn wait<T>(&self, mut look: impl FnMut(&[String]) -> Option<T>) -> Option<T> {
        let deadline = Instant::now() + PATIENCE;
        let mut lines = self.lock();
        loop {
            if let Some(found) = look(&lines.0) {
                return Some(found);
            }
            let left = deadline.saturating_duration_since(Instant::now());
            if lines.1 || left.is_zero() {
                return None;
            }
            lines = self.news.wait_timeout(lines, left).unwrap_or_else(PoisonError::into_inner).0;
        }
    }

    fn to_the_end(&self) {
        self.wait(|_| None::<()>);
    }

    fn text(&self) -> String {
        self.lock().0.join("\n")
    }
}
