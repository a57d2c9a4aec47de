//! Whether there is enough memory, before it is used.

use std::io;

/// Fails where the memory does not suffice for parts of so many bytes together. An allocation that fails ends the process.
pub fn check_memory(parts: impl IntoIterator<Item = u64>) -> io::Result<()> {
    let mut reserved = Vec::new();
    for part in parts {
        let mut bytes = Vec::<u8>::new();
        bytes.try_reserve_exact(usize::try_from(part).unwrap_or(usize::MAX))?;
        // Or the compiler leaves the allocation out.
        reserved.push(std::hint::black_box(bytes));
    }
    Ok(())
}
