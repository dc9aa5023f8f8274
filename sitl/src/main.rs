//! The `sitl` program. Everything is in the library, where `gcs sitl` finds it too.

fn main() -> std::process::ExitCode {
    crpl_sitl::program::cli::main()
}
