#![no_main]

#[path = "../readers.rs"]
#[allow(dead_code)] // each target uses a part
mod readers;

libfuzzer_sys::fuzz_target!(|bytes: &[u8]| {
    let _ = readers::shard(bytes);
});
