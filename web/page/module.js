'use strict';
// An instance of the WebAssembly module. Texts and bytes pass through its memory.
async function instantiate(module) {
  const { exports } = await WebAssembly.instantiate(module, {});
  const output = () => new Uint8Array(exports.memory.buffer, exports.output(), exports.output_len()).slice();
  const text = () => new TextDecoder().decode(output());

  // Calls a function of the module. What it says is wrong becomes an Error.
  function call(name, input, ...numbers) {
    const bytes = typeof input === 'string' ? new TextEncoder().encode(input) : input ?? new Uint8Array();
    const address = exports.input(bytes.length);
    new Uint8Array(exports.memory.buffer, address, bytes.length).set(bytes);
    if (!exports[name](...numbers)) throw new Error(text());
  }

  return {
    exports,
    bytes(...what) { call(...what); return output(); },
    json(...what) { call(...what); return JSON.parse(text()); },
  };
}
