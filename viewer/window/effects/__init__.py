"""The receipt: which effects the scene calls for, why, what each costs here, and switches to override it."""
