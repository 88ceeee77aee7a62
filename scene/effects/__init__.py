"""Which effects a scene calls for, with the evidence: nothing is computed that cannot be seen."""
