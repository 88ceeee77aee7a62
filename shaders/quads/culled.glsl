const uint CULLED = 0xFFFFFFFFu;  // a key that no finite depth has
