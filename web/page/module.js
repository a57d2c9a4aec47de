'use strict';
// The bytes of a text in base 85, see `as_text` in build.sh.
function unpacked(text, size) {
  const digits = [...Array(94).keys()].map(i => String.fromCharCode(i + 33)).filter(c => !'"&\'<>\\`'.includes(c));
  const value = Object.fromEntries(digits.slice(0, 85).map((digit, i) => [digit, i]));
  const view = new DataView(new ArrayBuffer(Math.ceil(size / 4) * 4));
  for (let i = 0; i < view.byteLength / 4; i++) {
    let number = 0;
    for (let k = 5 * i; k < 5 * i + 5; k++) number = 85 * number + value[text[k]];
    view.setUint32(4 * i, number);
  }
  return new Uint8Array(view.buffer, 0, size);
}

// A text of JSON as values: an integer that a Number cannot hold becomes a BigInt, such as a seed of 64 bits.
function parsed(json) {
  const marked = json.replace(/"[^"\\]*(?:\\.[^"\\]*)*"|-?\d[\d.eE+-]*/g, token => (/^\d{16,}$/.test(token) ? `"\\u0000${token}"` : token));
  return JSON.parse(marked, (_, value) => {
    if (typeof value !== 'string' || !/^\u0000\d+$/.test(value)) return value;
    const exact = BigInt(value.slice(1));
    return exact > Number.MAX_SAFE_INTEGER ? exact : Number(exact);
  });
}

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
    json(...what) { call(...what); return parsed(text()); },
  };
}
