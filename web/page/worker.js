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

// Before an evaluation, which may take long, the page gets what it needs to resume the run in another worker.
function report(state) {
  ended = state.end !== null;
  running &&= !ended;
  const snapshot = state.evaluates_next ? instance.bytes('last') : null;
  postMessage({ type: 'trained', run, state, seconds, policy: instance.bytes('policy'), snapshot });
}

// Trains up to `steps` steps, and not much longer than a slice of a second; less if an evaluation is next. Returns how many it was.
function train(steps) {
  const begin = performance.now();
  let state = null;
  let events = [];
  let trained = 0;
  do {
    state = instance.json('train', null, Math.min(steps - trained, CHUNK));
    events = events.concat(state.events);
    trained += state.trained;
  } while (trained < steps && !state.end && !state.evaluates_next && (performance.now() - begin) / 1000 < SLICE);
  seconds += (performance.now() - begin) / 1000;
  report({ ...state, events });
  return trained;
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
    ({ run, seconds } = data);
    running = ended = false;
    instance = await instantiate(module);
    guarded(() => {
      const description = instance.json('start', JSON.stringify(data.input));
      if (data.snapshot) instance.bytes('resume', data.snapshot);
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
  pause() {
    running = false;
    postMessage({ type: 'paused', run });
  },
  more(data) {
    for (let left = data.steps; left > 0 && !ended;) left -= guarded(() => train(Math.min(left, CHUNK))) ?? left;
  },
  file(data) {
    guarded(() => postMessage({ type: 'file', run, name: data.name, bytes: instance.bytes(data.name) }));
  },
};

onmessage = ({ data }) => {
  queue = queue.then(() => handlers[data.type](data)).catch(error => postMessage({ type: 'failed', run, message: error.message }));
};
