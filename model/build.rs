//! Stamps what is compiled with the sources that it is compiled from.
//!
//! | variable | what it is |
//! |---|---|
//! | `CRPL_REVISION` | git's HEAD, with `-dirty` if a source differs from it; `unknown` without git |
//! | `CRPL_SOURCES` | a hash of the bytes that decide the numbers of a flight |
//!
//! The script of each package that writes results: `gcs/build.rs` is a link to it. A package's sources are
//! its own and those of the packages below it, so an edit of `gcs` does not compile `model` again.

use std::hash::{DefaultHasher, Hash, Hasher};
use std::path::{Path, PathBuf};
use std::process::Command;

/// The workspace's packages with a library, lowest first.
const PACKAGES: [&str; 3] = ["sitl", "model", "gcs"];

fn main() {
    let sources = sources();
    sources.iter().for_each(|path| println!("cargo::rerun-if-changed={}", path.display()));
    println!("cargo::rerun-if-changed=build.rs");
    println!("cargo::rustc-env=CRPL_SOURCES={}", fingerprint(&sources));
    let revision = of_package().or_else(|| of_git(&sources)).unwrap_or_else(|| "unknown".into());
    println!("cargo::rustc-env=CRPL_REVISION={revision}");
}

/// Files and folders that are compiled. Cargo starts this script in the package's folder; a published
/// package lies alone there, with the lock file in it.
fn sources() -> Vec<PathBuf> {
    let own = std::env::var("CARGO_PKG_NAME").unwrap_or_default().replace("crpl-", "");
    let below = PACKAGES.iter().take_while(|package| **package != own);
    let folders = below.map(|package| Path::new("..").join(package)).chain([PathBuf::from("."), "..".into()]);
    let names = ["src", "pretrained", "configs", "Cargo.toml", "Cargo.lock"];
    let paths = folders.flat_map(|folder| names.map(|name| folder.join(name)));
    paths.filter(|path| path.exists()).collect()
}

/// The revision of which `cargo package` made this package.
fn of_package() -> Option<String> {
    let text: String = std::fs::read_to_string(".cargo_vcs_info.json").ok()?.split_whitespace().collect();
    let revision = text.split("\"sha1\":\"").nth(1)?.split('"').next()?;
    Some(mark(revision, text.contains("\"dirty\":true")))
}

fn of_git(sources: &[PathBuf]) -> Option<String> {
    // Sources from an archive may lie in another project's repository.
    git(["ls-files", "--error-unmatch", "Cargo.toml"])?;
    let head = git(["rev-parse", "HEAD"])?;
    // A commit changes the log of HEAD, a checkout HEAD itself.
    for name in ["HEAD", "logs/HEAD"] {
        let path = git(["rev-parse", "--git-path", name])?;
        if Path::new(&path).exists() {
            println!("cargo::rerun-if-changed={path}");
        }
    }
    let status = ["--no-optional-locks", "status", "--porcelain", "--"].map(PathBuf::from);
    let changes = git(status.iter().chain(sources))?;
    Some(mark(&head, !changes.is_empty()))
}

fn mark(revision: &str, dirty: bool) -> String {
    format!("{revision}{}", if dirty { "-dirty" } else { "" })
}

fn git<A: AsRef<std::ffi::OsStr>>(args: impl IntoIterator<Item = A>) -> Option<String> {
    let output = Command::new("git").args(args).output().ok()?;
    output.status.success().then(|| String::from_utf8_lossy(&output.stdout).trim().to_owned())
}

/// Names the bytes of the code and the versions of what it depends on. Another compiler may give another
/// name: it may round otherwise, too.
fn fingerprint(sources: &[PathBuf]) -> String {
    let mut files = Vec::new();
    let code = sources.iter().filter(|path| ["src", "Cargo.lock"].iter().any(|name| path.ends_with(name)));
    code.for_each(|path| collect(path, &mut files));
    files.sort();
    let mut hasher = DefaultHasher::new();
    for file in files {
        file.hash(&mut hasher);
        std::fs::read(&file).unwrap_or_default().hash(&mut hasher);
    }
    format!("{:016x}", hasher.finish())
}

fn collect(path: &Path, files: &mut Vec<PathBuf>) {
    match std::fs::read_dir(path) {
        Ok(entries) => entries.flatten().for_each(|entry| collect(&entry.path(), files)),
        Err(_) => files.push(path.into()),
    }
}
