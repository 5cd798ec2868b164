"""Writes rl/tests/golden/sac.safetensors: one update of soft actor-critic with torch 2.15.0 in double precision.

usage: python golden_sac.py FILE

Two cases: `plain`, and `context`, where a GRU of the actor and one of the critics read the last steps of the episode.
What the crate keeps in single precision is rounded to it before anything is computed. Parameters are flat: the shared
layer, the actor's GRU, the actor, the critics' GRU, both critics; of each layer its weight, then its bias.
"""

import math
import sys

import torch
from safetensors.torch import save_file

torch.manual_seed(0)
torch.set_default_dtype(torch.float64)

VECTOR, ACTION, WIDTH, STATE, LENGTH = 3, 2, 8, 4, 3
GAMMA, TAU, RATE, CLIP, ALPHA, TARGET_ENTROPY, CLONING = 0.9, 0.1, 1e-2, 0.05, 0.2, -1.0, 0.3
# lengths of the episodes, and whether they end by a termination (1), a time-out (2) or go on (0)
EPISODES = [(5, 1), (4, 2), (3, 0)]
INDICES = [0, 2, 4, 8, 11, 6]
BATCH = len(INDICES)


def rounded(*shape, scale=1.0):
    return (scale * torch.randn(*shape)).float().double()


vectors = [rounded(length + 1, VECTOR) for length, _ in EPISODES]
actions = [torch.tanh(rounded(length, ACTION)).float().double() for length, _ in EPISODES]
rewards = [rounded(length) for length, _ in EPISODES]
places = [(e, t) for e, (length, _) in enumerate(EPISODES) for t in range(length)]
tensors = {
    "vectors": torch.cat(vectors),
    "actions": torch.cat(actions),
    "rewards": torch.cat(rewards),
    "episodes": torch.tensor(EPISODES).double(),
    "indices": torch.tensor(INDICES).double(),
}


def gru_shapes(inputs):
    return [(3 * STATE, inputs), (3 * STATE,), (3 * STATE, STATE), (3 * STATE,)]


def head_shapes(inputs, outputs):
    return [(WIDTH, inputs), (WIDTH,), (outputs, WIDTH), (outputs,)]


class Net:
    """The parts of a network as lists of tensors."""

    def __init__(self, context):
        gru = gru_shapes(WIDTH + ACTION + 1) if context else []
        state = WIDTH + (STATE if context else 0)
        critic = head_shapes(state + ACTION, 1)
        shapes = {
            "trunk": [(WIDTH, VECTOR), (WIDTH,)],
            "actor_gru": gru,
            "actor": head_shapes(state, 2 * ACTION),
            "critic_gru": gru,
            "q1": critic,
            "q2": critic,
        }
        self.parts = {name: [rounded(*s, scale=0.4) for s in shape] for name, shape in shapes.items()}

    def flat(self, names=("trunk", "actor_gru", "actor", "critic_gru", "q1", "q2")):
        return torch.cat([p.detach().flatten() for name in names for p in self.parts[name]])

    def leaves(self, *names):
        return [p for name in names for p in self.parts[name]]


def fields(net, vector):
    weight, bias = net.parts["trunk"]
    return torch.relu(vector @ weight.T + bias)


def head(params, x):
    w1, b1, w2, b2 = params
    return torch.relu(x @ w1.T + b1) @ w2.T + b2


def cell(params, x, h):
    """torch.nn.GRUCell with these parameters."""
    weights = dict(zip(["weight_ih", "bias_ih", "weight_hh", "bias_hh"], params))
    return torch.func.functional_call(torch.nn.GRUCell(x.shape[-1], STATE), weights, (x, h))


def read(net, gru, h, episode, t):
    """The fields h of observation t beside what a GRU makes of the steps before it, which are not trained through."""
    if not gru:
        return h
    state = torch.zeros(1, STATE)
    for s in range(max(0, t - LENGTH), t):
        seen = fields(net, vectors[episode][s]).detach()
        item = torch.cat([seen, actions[episode][s], rewards[episode][s : s + 1]])
        state = cell(gru, item[None], state)
    return torch.cat([h, state[0]])


def draw(output, noise):
    mean, raw = output[:ACTION], output[ACTION:]
    std = (-5 + 3.5 * (torch.tanh(raw) + 1)).exp()
    normal = torch.distributions.Normal(mean, std)
    u = mean + std * noise
    squash = 2 * (math.log(2) - u - torch.nn.functional.softplus(-2 * u))
    return torch.tanh(u), (normal.log_prob(u) - squash).sum()


def q(critics, state, action):
    x = torch.cat([state, action])
    return torch.cat([head(critics["q1"], x), head(critics["q2"], x)])


def losses(net, target, noise, alpha):
    """Mean losses of the critics and of the actor, and the mean log-probability."""
    critic_loss = actor_loss = log_probs = 0
    for i, index in enumerate(INDICES):
        e, t = places[index]
        length, end = EPISODES[e]
        h, h_next = fields(net, vectors[e][t]), fields(net, vectors[e][t + 1])
        with torch.no_grad():
            output = head(net.parts["actor"], read(net, net.parts["actor_gru"], h_next, e, t + 1))
            action, log_prob = draw(output, noise[1][i])
            value = q(target.parts, read(net, target.parts["critic_gru"], h_next, e, t + 1), action).min()
            goes_on = 0.0 if end == 1 and t + 1 == length else 1.0
            y = rewards[e][t] + GAMMA * goes_on * (value - alpha * log_prob)
        state = read(net, net.parts["critic_gru"], h, e, t)
        critic_loss = critic_loss + 0.5 * (q(net.parts, state, actions[e][t]) - y).square().sum()
        output = head(net.parts["actor"], read(net, net.parts["actor_gru"], h.detach(), e, t))
        action, log_prob = draw(output, noise[0][i])
        actor_loss = actor_loss + alpha * log_prob - q(net.parts, state.detach(), action).min()
        cloning = (torch.tanh(output[:ACTION]) - actions[e][t]).square().sum()
        actor_loss = actor_loss + CLONING * cloning
        log_probs = log_probs + log_prob
    return critic_loss / BATCH, actor_loss / BATCH, log_probs / BATCH


for case in ["plain", "context"]:
    net, target = Net(case == "context"), Net(case == "context")
    noise = rounded(2, BATCH, ACTION)
    critic_names = ("critic_gru", "q1", "q2")
    tensors[f"{case}.params"] = net.flat()
    tensors[f"{case}.targets"] = target.flat(critic_names)
    tensors[f"{case}.noise"] = noise
    parts = ["trunk", "actor_gru", "actor", *critic_names]
    everything = net.leaves(*parts)
    for p in everything:
        p.requires_grad_()
    log_alpha = torch.tensor([math.log(ALPHA)], requires_grad=True)

    critic_loss, actor_loss, log_prob = losses(net, target, noise, ALPHA)
    trained_by_critics = net.leaves("trunk", *critic_names)
    trained_by_actor = net.leaves("actor_gru", "actor")
    for leaves, loss in [(trained_by_critics, critic_loss), (trained_by_actor, actor_loss)]:
        for p, g in zip(leaves, torch.autograd.grad(loss, leaves, retain_graph=True)):
            p.grad = g
    temperature_loss = -(log_alpha.exp() * (log_prob.detach() + TARGET_ENTROPY * ACTION)).sum()
    temperature_loss.backward()
    tensors[f"{case}.losses"] = torch.stack([critic_loss, actor_loss, log_prob]).detach()
    tensors[f"{case}.gradient"] = torch.cat([p.grad.flatten() for p in everything])

    torch.nn.utils.clip_grad_value_(everything, CLIP)
    torch.optim.Adam(everything, lr=RATE).step()
    torch.optim.Adam([log_alpha], lr=RATE).step()
    critics = net.flat(critic_names)
    old = tensors[f"{case}.targets"]
    tensors[f"{case}.params_after"] = net.flat()
    tensors[f"{case}.targets_after"] = old + TAU * (critics - old)
    tensors[f"{case}.log_temperature_after"] = log_alpha.detach()

save_file({name: t.contiguous() for name, t in tensors.items()}, sys.argv[1])
