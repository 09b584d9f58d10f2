//! The `stillcut` command: parse the arguments, call the library, turn the outcome into 0, 1 or 2.

use std::process::ExitCode;

fn main() -> ExitCode {
    stillcut::cli::main()
}
