//! The `sitl` program. Everything is in the library, where `gcs sitl` finds it too.

use crpl_sitl::program::{cli, terminal};

fn main() -> std::process::ExitCode {
    terminal::main(crpl_sitl::revision(), cli::EXAMPLES, |args| terminal::block_on(cli::run(args)))
}
