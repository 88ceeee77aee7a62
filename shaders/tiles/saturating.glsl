// Sums of pairs end at the largest uint: five million splats over a whole picture are more.
const uint TOO_MANY = 0xFFFFFFFFu;

uint saturating_sum(uint a, uint b) { return a > TOO_MANY - b ? TOO_MANY : a + b; }
