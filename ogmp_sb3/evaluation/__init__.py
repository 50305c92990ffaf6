"""Play a policy, record its episodes, measure them."""
