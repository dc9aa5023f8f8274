//! Which source made a result: written beside every one.

/// `git rev-parse HEAD` of the checkout in which this program was built and lies, with `-dirty` if
/// files differ from it; `unknown` for a program that lies in no checkout.
#[must_use]
pub fn revision() -> String {
    let program = std::env::current_exe().ok();
    let git = |args: &[&str]| {
        let folder = program.as_deref()?.parent()?;
        let output = std::process::Command::new("git").arg("-C").arg(folder).args(args).output().ok()?;
        let text = String::from_utf8(output.stdout).ok()?;
        output.status.success().then(|| text.trim().to_owned())
    };
    let Some(head) = git(&["rev-parse", "HEAD"]) else { return "unknown".into() };
    let dirty = git(&["status", "--porcelain", "--untracked-files=no"]).is_some_and(|s| !s.is_empty());
    if dirty { format!("{head}-dirty") } else { head }
}
