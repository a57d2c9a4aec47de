//! What a loop can have wrong. The numbers that prove it come from the rule that names it.

use serde::Serialize;

type Note = &'static str;

/// A mistake that people make in the loop around the update.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
pub struct LoopMistake {
    /// Its name for programs.
    pub id: Note,
    /// What they do, and what is right.
    pub what: Note,
    pub why: Note,
    pub mend: Note,
}

const fn mistake(id: Note, what: Note, why: Note, mend: Note) -> LoopMistake {
    LoopMistake { id, what, why, mend }
}

/// Every mistake: its name; then what is done, why it matters and how to mend it.
#[rustfmt::skip]
pub static LOOP_MISTAKES: &[LoopMistake] = &[
    // Ends
    mistake("state_not_advanced", "the observation is that of the episode's start at every step",
        "the agent neither sees nor learns what its actions lead to", "observation = next_observation at the end of the loop's body"),
    mistake("steps_after_the_end", "the environment is stepped on after an episode has ended",
        "what it says then is undefined, and an episode without end teaches nothing", "if terminated or truncated: observation, _ = env.reset()"),
    mistake("truncation_ignored", "the environment is stepped on after the time limit has ended an episode",
        "the limit has no effect, and Gymnasium says `truncated` at every further step", "done = terminated or truncated, not terminated alone; then env.reset()"),
    mistake("time_limit_stored_as_terminated", "rows that the time limit cut off are stored as terminated",
        "good states get the value of bad ones, and nothing in the observation tells why", "store `terminated`, not `terminated or truncated`"),
    mistake("terminated_never_stored", "rows that terminated are stored as if the episode went on",
        "the value of falling becomes that of a state to go on from, and values grow without end", "store `terminated` of the same env.step"),
    mistake("same_start_every_episode", "every episode is reset with the same seed and starts from the same observation",
        "the agent learns one start, and an evaluation from others fails", "env.reset(seed=seed) once, then env.reset()"),
    // Memory
    mistake("next_is_current", "s′ of the stored rows is s",
        "no row shows what an action leads to", "store copies: an array that is changed in place changes in the memory too; store s before s is replaced"),
    mistake("next_is_reset", "s′ of stored rows is the first observation of the next episode",
        "an end that is bootstrapped gets the value of a fresh start", "store the observation of env.step; with vectors info[\"final_obs\"], and no row for the step that resets"),
    mistake("stored_action_is_another", "the stored action is not the one that the environment executed",
        "an action is credited with what another one brought", "store the number that went into env.step"),
    mistake("reward_of_another_step", "the stored reward is that of another step",
        "an action is credited with what another one brought", "store observation, action, reward and next observation of one env.step together"),
    mistake("observation_changed", "one of s and s′ is an observation of the environment, and the other one is not",
        "the network gets other numbers for s than for s′, so the two do not belong to one task", "scale or round both alike, in a wrapper, and store copies"),
    mistake("row_that_never_happened", "stored rows lead from an observation to another that did not follow it",
        "the values are those of a task that does not exist", "sample one index for all columns; let the columns of the memory advance together"),
    mistake("one_transition_repeated", "all rows of a minibatch are one transition",
        "a minibatch is worth one row, and the gradient is noise", "draw an index for each row: rng.integers(len(memory), size=batch_size)"),
    mistake("samples_only_newest", "a minibatch is always the newest rows, in order",
        "consecutive rows are alike: the network forgets everything else", "sample from the whole memory"),
    mistake("samples_only_oldest", "new rows are never sampled",
        "the agent goes on learning from its first steps alone", "sample from all that is filled; let a full memory overwrite its oldest row"),
    mistake("memory_emptied", "the memory is emptied at the end of each episode",
        "minibatches are few, alike rows", "keep the memory over episodes; make it before the loop"),
    mistake("memory_too_small", "the memory holds fewer than four minibatches",
        "the same few rows are learned again and again, and everything else is forgotten", "a memory of 10,000 rows or more costs little"),
    // Exploration
    mistake("never_explores", "every action is the one with the largest Q-value, from the first step on",
        "actions that look bad at first are never tried", "with probability epsilon take env.action_space.sample()"),
    mistake("epsilon_never_falls", "ε stays where it began",
        "the agent mostly acts at random, and never sees what its policy leads to", "lower epsilon after each step or episode"),
    mistake("epsilon_falls_at_once", "ε is at its end within a few episodes",
        "hardly anything is explored", "lower epsilon over a good part of the run; look whether a factor per episode is applied per step, and at integer division"),
    mistake("epsilon_grows", "ε grows",
        "the better the policy, the less it is followed", "look at the sign in the formula, and at the order of start and end"),
    mistake("epsilon_not_applied", "ε is above 0, but every action is the one with the largest Q-value",
        "nothing is explored", "if rng.random() < epsilon: action = env.action_space.sample()"),
    mistake("epsilon_inverted", "the action is random with probability 1 − ε",
        "the agent explores where it should follow its policy", "if rng.random() < epsilon, not >"),
    mistake("exploration_misses_an_action", "an action is never drawn",
        "what it would bring is never learned", "rng.integers(num_actions) leaves the end out, random.randint(0, num_actions - 1) has it; or env.action_space.sample()"),
    mistake("greedy_is_not_the_largest", "the action that is taken without exploring is not the one with the largest Q-value",
        "the policy is not the one that is learned", "action = q.argmax(), over the axis of actions; not argmin, not min"),
    mistake("acts_on_an_old_observation", "the Q-values by which the agent acts are those of an earlier observation",
        "the agent acts too late", "observation = next_observation before the next action is chosen"),
    // Target network
    mistake("target_never_updated", "the target network never changes",
        "every target is that of the first, random network", "target_net.load_state_dict(q_net.state_dict()) every few hundred steps, or a soft update at each"),
    mistake("target_is_online", "the target network equals the online network at every update",
        "the targets move with every step, which is what the target network is there to prevent", "target_net = copy.deepcopy(q_net), then copy the weights now and then only"),
    mistake("target_not_initialised", "the target network begins with other weights than the online network",
        "the first targets are those of another random network", "target_net.load_state_dict(q_net.state_dict()) before the loop"),
    mistake("tau_reversed", "the soft update takes nearly all of the online network: τ and 1 − τ are exchanged",
        "the target network follows every step, which is what it is there to prevent", "target = tau * online + (1 - tau) * target, with a small tau"),
    mistake("online_overwritten_by_target", "the online network gets the weights of the target network",
        "what was learned since is thrown away", "target_net.load_state_dict(q_net.state_dict()), not the other way round"),
    mistake("target_updated_too_rarely", "the target network moves so rarely that it is nearly the first one",
        "what has been learned hardly gets into the targets", "a copy every few hundred steps, or tau = 0.005 at each"),
    // Updates
    mistake("online_never_changes", "the online network never changes",
        "nothing is learned", "optimizer.step() after loss.backward(); give the optimizer the parameters of this network"),
    mistake("layer_never_changes", "a tensor of the online network never changes",
        "what it could learn is not learned", "give the optimizer all parameters; look for detach, numpy() and requires_grad=False in the forward pass"),
    mistake("optimizer_made_anew", "the optimiser begins anew at every update",
        "Adam's first step is the learning rate for every weight, however small its gradient", "make the optimizer once, before the loop"),
    mistake("learns_at_episode_ends_only", "there is one update at the end of an episode, and none between",
        "most of what the memory holds is never learned from", "update after every step, or every few; or do as many updates at the end as the episode had steps"),
    mistake("learns_before_a_batch_is_there", "the first minibatches are larger than what the memory holds",
        "the network is fitted to a handful of rows", "begin when the memory holds some minibatches: if len(memory) < warm_up: continue"),
    mistake("learns_while_evaluating", "updates go on while whole episodes are played with ε = 0",
        "what is measured changes while it is measured", "evaluate in an environment of its own, without storing and learning"),
    mistake("diverges", "the targets grow beyond every return that the rewards allow, or are not finite",
        "the values no longer mean anything", "a smaller learning rate, a slower target network, terminated rows without bootstrap, gamma below 1"),
    mistake("units_die", "a hidden layer is 0 for every observation",
        "the Q-values are the same for all observations, and no gradient gets through", "a smaller learning rate, scaled observations and rewards, another start of the weights"),
];
