#![no_main]

libfuzzer_sys::fuzz_target!(|data: &[u8]| crpl_fuzz::files::radio(data));
