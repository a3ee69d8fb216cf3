#version 450
// Where a vertex is, and which way its surface looks, in the axes of the camera.
// SAPIEN finds blocks and inputs by these names and places, and wants each set to have its binding 0.

layout(set = 0, binding = 0) uniform CameraBuffer {
  mat4 viewMatrix;
  mat4 projectionMatrix;
  mat4 viewMatrixInverse;
  mat4 projectionMatrixInverse;
  float width;
  float height;
} camera;

layout(set = 1, binding = 0) uniform ObjectTransformBuffer {
  mat4 modelMatrix;
} placed;

layout(set = 1, binding = 1) uniform ObjectDataBuffer {
  uvec4 segmentation;
  float transparency;
  int shadeFlat;
} body;

layout(location = 0) in vec3 position;
layout(location = 1) in vec3 normal;
layout(location = 2) in vec2 uv;
layout(location = 3) in vec3 tangent;
layout(location = 4) in vec3 bitangent;

layout(location = 0) out vec3 outPosition;
layout(location = 1) out vec3 outNormal;
layout(location = 2) out vec2 outUV;

void main() {
  mat4 cameraFromModel = camera.viewMatrix * placed.modelMatrix;
  vec4 seen = cameraFromModel * vec4(position, 1.0);
  outPosition = seen.xyz;
  outNormal = mat3(cameraFromModel) * normal;  // no mesh of ours is scaled unevenly
  outUV = uv;
  gl_Position = camera.projectionMatrix * seen;
}
