// Trains, so that the page stays free to draw. Each message of the page is handled after the one before.
let module = null;
let instance = null;
// Which run the messages are about: the page ignores those of a run before.
let run = 0;
let ended = false;
let running = false;
// Environment steps a second; 0 for as many as possible.
let speed = 0;
// Seconds of training so far.
let seconds = 0;
let queue = Promise.resolve();

const CHUNK = 20;
const SLICE = 0.05;

function report(state) {
  ended = state.end !== null;
  running &&= !ended;
  postMessage({ type: 'trained', run, state, seconds, policy: instance.bytes('policy') });
}

// Trains up to `steps` steps, and not much longer than a slice of a second.
function train(steps) {
  const begin = performance.now();
  let state = null;
  let events = [];
  for (let left = steps; left > 0 && !state?.end; left -= CHUNK) {
    state = instance.json('train', null, Math.min(left, CHUNK));
    events = events.concat(state.events);
    if ((performance.now() - begin) / 1000 > SLICE) break;
  }
  seconds += (performance.now() - begin) / 1000;
  report({ ...state, events });
}

function tick() {
  if (!running) return;
  // Each of the two is at most 20 times a second.
  guarded(() => train(speed ? Math.max(1, Math.round(speed * SLICE)) : Infinity));
  setTimeout(tick, speed ? 1000 * SLICE : 0);
}

function guarded(action) {
  try {
    return action();
  } catch (error) {
    running = false;
    ended = true;
    // A trap leaves an instance that cannot be used any more.
    const message = error instanceof WebAssembly.RuntimeError ? `the module has failed: ${error.message}` : error.message;
    postMessage({ type: 'failed', run, message });
  }
}

const handlers = {
  module(data) { module = data.module; },
  async start(data) {
    ({ run } = data);
    running = ended = false;
    seconds = 0;
    instance = await instantiate(module);
    guarded(() => {
      const description = instance.json('start', JSON.stringify(data.input));
      postMessage({ type: 'started', run, description });
      report({ ...instance.json('train', null, 0) });
    });
  },
  run(data) {
    ({ speed } = data);
    if (running || ended) return;
    running = true;
    tick();
  },
  pause() { running = false; },
  more(data) {
    for (let left = data.steps; left > 0 && !ended; left -= CHUNK) guarded(() => train(Math.min(left, CHUNK)));
  },
  file(data) {
    guarded(() => postMessage({ type: 'file', name: data.name, bytes: instance.bytes(data.name) }));
  },
};

onmessage = ({ data }) => {
  queue = queue.then(() => handlers[data.type](data)).catch(error => postMessage({ type: 'failed', run, message: error.message }));
};
