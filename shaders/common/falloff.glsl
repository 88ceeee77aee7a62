const float ROOT_HALF_LOG2_E = 0.84932180028801904;  // exp(-q/2) = exp2(-(0.849 sqrt q)²)
