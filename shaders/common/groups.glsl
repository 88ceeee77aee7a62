// Work groups of a dispatch that has rows where one dimension has no room for them: see programs.run_groups. There may
// be a few too many.

uint group_number() { return gl_WorkGroupID.y * gl_NumWorkGroups.x + gl_WorkGroupID.x; }
