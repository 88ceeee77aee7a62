// Records of projected splats, four numbers each: in storage buffers or, where the driver's are too small for the
// scene, in textures. An array has a slot for its buffer and a unit for its texture, also where that is an image:
// see renderers/gl/project.py. Flags: TEXTURED, TEXTURE_WIDTH.
#include "common/texels.glsl"

#if HAS_TEXTURED
#define RECORDS_READ(slot, unit, Block, array) layout(binding = unit) uniform sampler2D array
#define RECORDS_WRITTEN(slot, unit, Block, array) layout(rgba32f, binding = unit) writeonly uniform image2D array
#define RECORD(array, index) texelFetch(array, texel_of(index), 0)
#define WRITE_RECORD(array, index, record) imageStore(array, texel_of(index), record)
#else
#define RECORDS_READ(slot, unit, Block, array) layout(std430, binding = slot) readonly buffer Block { vec4 array[]; }
#define RECORDS_WRITTEN(slot, unit, Block, array) layout(std430, binding = slot) writeonly buffer Block { vec4 array[]; }
#define RECORD(array, index) array[index]
#define WRITE_RECORD(array, index, record) array[index] = record
#endif
