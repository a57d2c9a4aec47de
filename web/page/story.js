// What happened in a run, in words: a headline, and then what explains it.

function story({ config, evaluations, statistics, state, failure, refused }) {
  if (refused) return ['These settings give no run.'];
  if (failure) return failed(config, failure);
  const steps = number(state.env_steps);
  if (!evaluations.length) {
    if (!state.env_steps) return ['The network knows nothing yet.', 'Press Train. Until then the pole falls within a fraction of a second.'];
    return state.updates
      ? [`It has learned for ${number(state.updates)} updates, and has not been evaluated yet.`]
      : [`It pushes at random and fills its memory: ${steps} of ${number(config.replay?.warmup_steps ?? 0)} steps.`];
  }
  const latest = evaluations.at(-1);
  const best = evaluations.reduce((best, one) => (one.mean >= best.mean ? one : best));
  const solved = evaluations.find(one => one.solved);
  const fallen = best.mean >= 100 && latest.mean < 0.5 * best.mean;
  const returns = one => `the mean return was ${rounded(one.mean)} after ${number(one.env_steps)} steps`;
  if (fallen) {
    return [
      solved ? 'It had solved the task, and lost it again.' : 'It had learned something, and lost it again.',
      `At its best ${returns(best)}. Now it is ${rounded(latest.mean)}.`, ...causes(config, statistics.at(-1)),
      'The best policy is kept: “Save best.safetensors” saves it, and dropping that file here plays it.',
    ];
  }
  if (solved) {
    const after = evaluations.slice(evaluations.indexOf(solved) + 1);
    const lowest = after.reduce((low, one) => (one.mean < low.mean ? one : low), solved);
    const lines = [
      `Solved after ${number(solved.env_steps)} steps: ${number(solved.episodes)} episodes have a mean return of ${rounded(solved.mean)}.`,
      `CartPole counts as solved from ${task.solved_return}; ${task.return_range[1]} is the most that an episode can give.`,
    ];
    if (lowest.mean < 0.6 * task.solved_return) lines.push(`On the way ${returns(lowest)}, the lowest since. It has recovered to ${rounded(latest.mean)}.`);
    if (state.end === 'lasting') lines.push(`The run has ended, because this policy lasts ${number(config.stop_when_lasting_steps)} steps too.`);
    else if (state.end) lines.push(`The run has ended. The latest evaluation has a mean return of ${rounded(latest.mean)}.`);
    return lines;
  }
  if (state.end) {
    return [`It has not solved the task in ${steps} steps.`, `At its best ${returns(best)}; ${task.solved_return} would have solved it.`, ...causes(config, statistics.at(-1))];
  }
  return [
    `After ${number(latest.env_steps)} steps the pole stands for ${rounded(latest.mean)} steps on average.`,
    `A policy that pushes at random manages about ${Math.round(task.random_return)}, and ${task.solved_return} solve the task.`,
  ];
}

function failed(config, failure) {
  const lines = ['The run has failed.', failure[0].toUpperCase() + failure.slice(1) + '.'];
  if (failure.includes('diverged')) {
    lines.push(`The numbers grew until a float could not hold them. ${config?.target?.kind === 'none' ? 'A target network' : 'A smaller learning rate'} would slow them down.`);
  }
  return lines;
}

// What the settings and the numbers from inside give as reasons.
function causes(config, numbers) {
  const lines = [];
  const gamma = config.gamma;
  // What an episode of full length is worth at its start.
  const possible = gamma < 1 ? (1 - gamma ** task.max_steps) / (1 - gamma) : task.max_steps;
  if (numbers?.max_q > 1.3 * possible) {
    lines.push(`It expects a return of ${rounded(numbers.max_q)}, and with γ = ${gamma} no more than ${rounded(possible)} is possible: its Q-values do not mean anything any more.`);
  }
  if (numbers?.dead_relu_share > 0.5) lines.push(`${number(100 * numbers.dead_relu_share)} % of its hidden units are always 0, and learn no more.`);
  if (config.target?.kind === 'none') lines.push('There is no target network: every update also moves the values that it aims at.');
  if (config.replay?.capacity <= 2 * config.replay?.batch_size) {
    lines.push('There is no replay memory to speak of: it learns from the latest steps alone, which resemble each other, and forgets the others.');
  } else if (numbers?.terminal_share < 0.005) {
    lines.push(`Only ${rounded(100 * numbers.terminal_share)} % of the steps in its memory end an episode: it forgets what makes the pole fall.`);
  }
  const rate = config.optimizer?.learning_rate;
  if (rate >= 0.01) lines.push(`A learning rate of ${rate} makes long steps: each update can undo what earlier ones have learned.`);
  if (rate <= 0.0001) lines.push(`A learning rate of ${rate} makes short steps: it may need a longer run.`);
  if (gamma <= 0.9) lines.push(`With γ = ${gamma} it looks about ${number(1 / (1 - gamma || 1))} steps ahead, and the cart takes more to reach the end of the track.`);
  if (config.network?.hidden.length && Math.max(...config.network.hidden) < 16) lines.push(`${Math.max(...config.network.hidden)} units in a layer are few.`);
  if (!lines.length) lines.push('No setting stands out. Deep Q-learning is not stable; another seed may end otherwise.');
  return lines;
}
