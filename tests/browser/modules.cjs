// The WebAssembly modules in Node: their kernels against the reference, and their runs against the program's.
//
//   MODULES=PLACE web/build.sh DIR
//   node tests/browser/modules.cjs --binary BINARY --modules PLACE
'use strict';
const assert = require('node:assert/strict');
const { execFileSync } = require('node:child_process');
const fs = require('node:fs');
const os = require('node:os');
const path = require('node:path');
const v8 = require('node:v8');
const vm = require('node:vm');
const { parseArgs } = require('node:util');

const { values: options } = parseArgs({ options: { binary: { type: 'string' }, modules: { type: 'string' } } });
// Node 20 has relaxed SIMD behind a flag, later ones have it without.
if (process.versions.v8 < '11.4') v8.setFlagsFromString('--experimental-wasm-relaxed-simd');
const root = path.join(__dirname, '../..');
const instantiate = vm.runInThisContext(`${fs.readFileSync(path.join(root, 'web/page/module.js'), 'utf8')}; instantiate`);
const directory = fs.mkdtempSync(path.join(os.tmpdir(), 'modules-'));

// A config each, as short as it can be and still learn.
const RUNS = [
  ['cartpole', ['budget.steps=2500', 'evaluation.every_steps=1000']],
  ['plain', ['budget.steps=4000', 'seed=7']],
  ['tutorial', ['budget.episodes=30', 'network.hidden=[19,5]']],
];

// What the program makes of the runs.
function expected() {
  return RUNS.map(([name, sets], i) => {
    const out = path.join(directory, String(i));
    const arguments_ = ['train', '--quiet', '--config', path.join(root, `configs/${name}.json`), '--out', out];
    execFileSync(path.resolve(options.binary), [...arguments_, ...sets.flatMap(one => ['--set', one])]);
    const last = fs.readFileSync(path.join(out, 'checkpoints/last.safetensors'));
    const summary = JSON.parse(fs.readFileSync(path.join(out, 'summary.json')));
    return { last, sha256: summary.weights_sha256, perSecond: summary.updates / summary.wall_seconds };
  });
}

async function check(name, expected) {
  const bytes = fs.readFileSync(path.join(options.modules, `${name}.wasm`));
  if (!WebAssembly.validate(bytes)) {
    console.log(`${name}: NOT CHECKED, this Node does not know its instructions`);
    return;
  }
  const module = await WebAssembly.compile(bytes);
  assert.deepEqual(WebAssembly.Module.imports(module), []);
  for (const [i, [config, sets]] of RUNS.entries()) {
    const instance = await instantiate(module);
    const text = fs.readFileSync(path.join(root, `configs/${config}.json`), 'utf8');
    const { instruction_set: used } = instance.json('start', JSON.stringify({ name: config, text, sets }));
    const begin = performance.now();
    let state;
    do state = instance.json('train', null, 1000); while (!state.end);
    const perSecond = state.updates / (performance.now() - begin) * 1000;
    assert.equal(state.weights_sha256, expected[i].sha256, `${name}, ${config}: other weights`);
    assert(expected[i].last.equals(Buffer.from(instance.bytes('last'))), `${name}, ${config}: another last.safetensors`);
    const share = perSecond / expected[i].perSecond;
    console.log(`${name}, ${config}: ${state.weights_sha256.slice(0, 16)}…, ${Math.round(perSecond)} updates a second on ${used}, ${share.toFixed(2)} of the program's`);
  }
  const { exports } = await instantiate(module);
  let differing = 0;
  for (let seed = 0; seed < 150; seed++) differing += exports.differing_numbers(seed);
  assert.equal(differing, 0, `${name}: ${differing} numbers are not those of the reference`);
}

// What is wrong must come back as a message.
async function refuses() {
  const module = await WebAssembly.compile(fs.readFileSync(path.join(options.modules, 'scalar.wasm')));
  const instance = await instantiate(module);
  const start = (text, sets = []) => instance.json('start', JSON.stringify({ name: 'x.json', text, sets }));
  assert.throws(() => start('{'), /x\.json: EOF/);
  assert.throws(() => start('{}', ['gamma=2']), /`gamma` is 2; allowed: a number from 0 to 1/);
  assert.throws(() => start('{}', [`network.hidden=[${Array(16).fill(4096)}]`, 'replay.capacity=100000000']), /GiB/);
  assert.throws(() => instance.json('train', null, 1), /no run has been started/);
  assert.throws(() => instance.json('step', null, 0), /no policy has been loaded/);
  assert.throws(() => instance.json('load', 'hello'), /safetensors/);
  start('{}');
  assert.throws(() => instance.bytes('best'), /no best policy/);
}

async function main() {
  const program = expected();
  for (const name of ['relaxed-simd', 'simd128', 'scalar']) await check(name, program);
  await refuses();
  fs.rmSync(directory, { recursive: true, force: true });
}

main().catch(error => {
  console.error(`FAILED: ${error.stack}`);
  process.exit(1);
});
