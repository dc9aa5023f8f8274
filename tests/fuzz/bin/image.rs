#![no_main]

libfuzzer_sys::fuzz_target!(|data: &[u8]| crpl_fuzz::wire::image(data));
